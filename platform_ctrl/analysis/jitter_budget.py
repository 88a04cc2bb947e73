"""The budget of a sampled loop: the effect of each disturbance on each performance output, in continuous time.

The frequencies between zero and half the sample frequency are divided into panels; a panel stands for itself and for
all its images. Where a controller repeats itself after a cycle of N samples only, all this holds of the N-th part of
the sample frequency, and M below is of the components that its images belong to (`hybrid_plant`). Averaged over the
instant within the period, the density of an output at an image is that of the same frequency of the disturbance, and
what the sampler brings there from all others:

    S_z(ω_n) = |G₀(ω_n)|² S_w(ω_n) + Σ_{k ≠ n} |P_zu H(ω_n) M P_yw(ω_k)|² S_w(ω_k),        ω_n = θ + n ω_s.

Sums over the images beyond those that are kept are exact for outputs that are not integrated, and bounded for
integrated ones (`OpenLoop.remaining_images`); more images are taken until the bound is below the tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis import budget_integrals as integrals
from platform_ctrl.analysis import hybrid_plant as hybrid
from platform_ctrl.analysis.interconnection import Modulator, MultiRate
from platform_ctrl.analysis.poles import continuous_poles, poles
from platform_ctrl.analysis.system import ComplexArray, System
from platform_ctrl.common.arguments import positive, within
from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError

# Images on each side to begin with, and those of outputs to which they may grow.
_IMAGES, _MOST_IMAGES = 5, 320
# Samples of a cycle from which on an image has so short a way that curves over frequency have points enough.
_MANY_SAMPLES = 100
# Panels are halved so often.
_HALVINGS = 48
# The errors of so many panels may add up.
_ADDING = 30.0
# A source counts in the error at least as much as this share of all sources.
_SMALL = 1e-6
# Numbers that are kept for the next controller, of a cycle less of them; numbers of densities at once.
_MOST_KEPT, _MOST_AT_ONCE = 4_000_000, 1_000_000
# Frequencies that differ by less, relative, are the same.
_SAME = 1e-12
# Poles below this share of the sample frequency are those of what turns freely, but for rounding.
_RESTING = 1e-9


class JitterBudget:
    """A plant with sampler and hold and its disturbances, prepared for budgets with one controller after the other.

    `exposures` are lengths of windows, s, for displacement, smear and jitter. Motion of the outputs below the frequency
    `lowest`, rad/s, is left out of the rms and the displacement (not of smear and jitter, to which it hardly
    contributes): an angle held by a noisy gyro drifts without bound.
    """

    def __init__(
        self,
        plant: hybrid.HybridPlant,
        sources: Sequence[hybrid.Disturbance],
        exposures: Sequence[float] = (),
        lowest: float = 0.0,
    ) -> None:
        self.plant, self.open_loop, self.sources = plant, hybrid.OpenLoop(plant), tuple(sources)
        self.lowest = positive("jitter budget: lowest", lowest, zero=True)
        if not self.lowest < 0.5 * plant.sample_frequency:
            raise ArgumentError("jitter budget: lowest must be below half the sample frequency")
        self.exposures = tuple(exposures)
        if len({one.name for one in self.sources}) < len(self.sources):
            raise ArgumentError("jitter budget: sources must have names that differ")
        self.random = [one for one in self.sources if isinstance(one, hybrid.RandomDisturbance)]
        self.noise = [one for one in self.sources if isinstance(one, hybrid.SampleNoise)]
        self.sines = [one for one in self.sources if isinstance(one, hybrid.SineDisturbance)]
        starts = np.cumsum([0, *(len(one.inputs) for one in self.random)])[:-1]
        # Sums over the last axis, the columns of all random sources, for each source.
        self._of_sources = partial(np.add.reduceat, indices=starts, axis=-1)
        ends = [s.knots[-1] for one in self.random for s in one.spectra]
        highest = max([*ends, *(one.frequency for one in self.sines)], default=0.0)
        # Every frequency of a source is the image of one below half of what the controller takes for one, and every
        # component has an image.
        self.images = max(_IMAGES, math.ceil(0.5 * plant.cycle), math.ceil(highest / plant.turn))
        if self.images > hybrid.MOST_OF_SOURCES:
            raise ArgumentError(
                f"jitter budget: a source reaches {highest / plant.sample_frequency:.3g} times the sample frequency, "
                f"at most {hybrid.MOST_OF_SOURCES / plant.cycle:.4g} times are possible; end it earlier"
            )
        self._known: dict[integrals.Panel, integrals.NodeResponses] = {}
        self._kept = 0

    def of(
        self, controller: System | MultiRate, tolerance: float = 1e-6, *, over_frequency: bool = True
    ) -> integrals.BudgetResult:
        """Return the budget with a controller u = K y, all of it of the plant's sample period or a part of it slower.

        `tolerance` bounds the relative error of each variance. Without cumulative variances, `over_frequency`, it is
        faster. Raises `ArgumentError` where the loop is not stable, or an angle drifts without bound.
        """
        tolerance = within("jitter budget: tolerance", tolerance, 1e-11, 0.1)
        if isinstance(controller, System):
            controller = MultiRate(controller)
        z = self.open_loop.closed_poles(controller)
        while True:
            parts = self._lines(controller, over_frequency)
            random = self.random or self.noise
            found = self._integrated(controller, z, tolerance, over_frequency) if random else []
            out = integrals.assembled(self.plant, self.sources, self.exposures, self.lowest, found, parts, self.images)
            if out.remaining <= tolerance or self.images >= max(_MOST_IMAGES, 2 * self.plant.cycle):
                return out
            self.images *= 2
            # The prepared responses have too few images.
            self._known, self._kept = {}, 0

    def edges(self, over_frequency: bool) -> FloatArray:
        """Return the edges of panels that no controller changes, of a cycle more of them for curves over frequency."""
        plant, turn = self.plant, self.plant.turn
        dense = plant.cycle == 1 or (over_frequency and plant.cycle <= _MANY_SAMPLES)
        knots = [self.lowest, *(k for one in self.random for s in one.spectra for k in s.knots)]
        own = poles(plant.plant.A)
        own = own[np.abs(own) > _RESTING * turn]
        if not dense:
            # Resonances wider than the distance of images need no panels of their own.
            own = own[(np.abs(own.real) < turn) | (np.abs(own) < turn)]
        found = np.concatenate([np.array(knots), integrals.edges_around(own)])
        folded = np.abs(found - turn * np.round(found / turn))
        least = min([1e-4 * turn, *(k for k in knots if k > 0.0), *(0.1 * np.abs(own))])
        decades = math.log10(0.5 * turn / least)
        count = max(2, math.ceil((3.0 if dense else 1.0) * decades))
        return np.concatenate([folded, np.geomspace(least, 0.5 * turn, count)])

    def _integrated(
        self, controller: MultiRate, z: ComplexArray, tolerance: float, over_frequency: bool
    ) -> list[integrals.Contribution]:
        """Return the integrals over all panels, halved until their errors are below the tolerance."""
        half = 0.5 * self.plant.turn
        s = continuous_poles(z[np.abs(z) > 0.0], math.pi / half)
        s = s[np.abs(s) > _RESTING * self.plant.turn]
        fixed = self.edges(over_frequency)
        base = integrals.between(fixed, 0.0, half)
        # Poles that a slider hardly moves stay within existing panels, whose responses are known.
        ends = np.array([high for _, high in base])
        width = np.array([high - low for low, high in base])[
            np.minimum(np.searchsorted(ends, np.abs(s.imag)), len(ends) - 1)
        ]
        active = integrals.between(
            np.concatenate([fixed, integrals.edges_around(s[width > integrals.WIDE * np.abs(s.real)])]), 0.0, half
        )
        done: list[integrals.Contribution] = []
        for _ in range(_HALVINGS):
            # Some panels after the others: their densities are large.
            step = max(1, _MOST_AT_ONCE // (21 * self._size))
            every = range(0, len(active), step)
            found = integrals.Contribution.joined(
                [self._contribution(active[k : k + step], controller, over_frequency) for k in every]
            )
            total = np.sum([one.variance.sum(axis=0) for one in [*done, found]], axis=0)
            least = tolerance * (total + _SMALL * total.sum(axis=1, keepdims=True)) / _ADDING
            good = np.all(found.error <= least, axis=(1, 2, 3))
            done.append(found.chosen(good))
            active = [
                part for panel, right in zip(active, good, strict=True) if not right for part in integrals.halves(panel)
            ]
            if not active:
                return done
        words = "jitter budget: a variance grows without bound towards zero frequency"
        raise ArgumentError(f"{words}; give the lowest frequency that counts")

    def _contribution(
        self, panels: list[integrals.Panel], controller: MultiRate, over_frequency: bool
    ) -> integrals.Contribution:
        prepared = self._prepared(panels)
        density, tail = self._densities(prepared, controller)
        half, P = integrals.nodes(panels)[1], len(panels)
        by_panel, tail = (one.reshape(P, 21, *one.shape[1:]) for one in (density, tail))
        frequency = np.abs(prepared.frequency).reshape(P, 21, -1)
        weights = prepared.weights.reshape(-1, *frequency.shape)
        scale = (half / (2.0 * math.pi))[:, None, None]
        fine, coarse = (
            np.einsum("wpkf,pkfgi->pwgi", weights * rule[:, None], by_panel, optimize=False) * scale[:, None]
            for rule in (integrals.KRONROD, integrals.GAUSS)
        )
        steps = []
        if over_frequency:
            members = np.einsum("k,pkf,pkfgi->pfgi", integrals.KRONROD, weights[0], by_panel) * scale[:, None]
            for k, panel in enumerate(panels):
                step = integrals.between_nodes(panel, frequency[k], by_panel[k], members[k], self.plant.turn)
                # Every image has the nodes that any of them needs.
                steps.append(step if self.plant.cycle == 1 else integrals.thinned(*step, self.plant.turn))
        return integrals.Contribution(
            panels=np.array(panels),
            variance=fine,
            error=np.abs(fine - coarse),
            remaining=np.einsum("k,pkgi->pgi", integrals.KRONROD, tail) * scale,
            steps=steps,
        )

    @property
    def _size(self) -> int:
        """Numbers at one node."""
        sources, packed = len(self.random) + len(self.noise), self.plant.controls**2
        return (2 * self.images + 1) * ((self.plant.outputs + packed) * (sources + packed) + self.open_loop.size)

    def _prepared(self, panels: list[integrals.Panel]) -> integrals.NodeResponses:
        new = [one for one in panels if one not in self._known]
        made: dict[integrals.Panel, integrals.NodeResponses] = {}
        if new:
            block = self._evaluated(integrals.nodes(new)[0].ravel())
            for k, one in enumerate(new):
                made[one] = block.rows(slice(21 * k, 21 * (k + 1)))
            size = sum(item.size for item in block if isinstance(item, np.ndarray))
            if self._kept + size <= _MOST_KEPT // self.plant.cycle:
                self._known |= made
                self._kept += size
        return integrals.joined([made[one] if one in made else self._known[one] for one in panels])

    def _evaluated(self, theta: FloatArray) -> integrals.NodeResponses:
        plant, count = self.plant, self.images
        images = np.arange(-count, count + 1)
        family = self.open_loop.family(theta, images)
        columns = np.concatenate(
            [
                np.zeros((*family.frequency.shape, plant.disturbances, 0)),
                *(one.columns(family.frequency, plant.disturbances) for one in self.random),
            ],
            axis=-1,
        )
        ends = np.sort(np.abs(np.add.outer(images, [0.0, 0.5])), axis=1) * plant.turn
        spectra = [one for source in self.random for one in source.spectra]
        inside = tuple(
            k
            for k, (low, high) in enumerate(ends)
            if any(low <= one.knots[-1] and high >= one.knots[0] for one in spectra)
        )
        columns = columns[:, list(inside)]
        measured, held = family.measured[:, list(inside)] @ columns, family.held * family.integral
        return integrals.NodeResponses(
            theta,
            family.frequency,
            inside,
            (family.direct * family.integral)[:, list(inside)] @ columns,
            measured,
            held[:, list(inside)],
            integrals.outer(held.conj()),
            integrals.packed(self.open_loop.remaining_images(theta, family.held)),
            family.sampled,
            self.weights(family.frequency),
        )

    def weights(self, frequency: FloatArray) -> FloatArray:
        """Return the counted parts (W, ...): all, then displacement, smear and jitter for each exposure."""
        above = np.abs(frequency) >= self.lowest
        out = [above.astype(np.float64)]
        for one in self.exposures:
            shares = integrals.window_shares(frequency, one)
            out += [shares.displacement * above, shares.smear, shares.jitter]
        return np.stack(out)

    def _densities(self, at: integrals.NodeResponses, controller: MultiRate) -> tuple[FloatArray, FloatArray]:
        """Return one-sided densities of the outputs (N, F, G, q) and what the images beyond add (N, G, q)."""
        M = self.open_loop.modulator(controller, at.theta, at.sampled)
        N, F, q, size = at.outer.shape
        R, count = self.plant.cycle, len(self.random)
        # The controls of each component, and all its images.
        moved = np.zeros((N, size, R, count + len(self.noise)))
        component = (np.arange(F) - F // 2) % R
        inside = np.array(at.inside, dtype=np.intp)
        own = np.zeros((N, 0, count, q))
        if count and inside.size:
            moved[..., :count], own = self._moved(at, M, component[inside])
        for j, one in enumerate(self.noise):
            moved[..., count + j] = 2.0 * self.plant.period * one.rms**2 * integrals.moved_by_samples(M, one.measured)
        density = integrals.aliased(at.outer, moved[:, :, component] if R > 1 else moved)
        density[:, inside, :count] = own
        rest = at.rest.swapaxes(1, 2).reshape(N, q, -1) @ moved.swapaxes(1, 2).reshape(N, R * size, -1)
        return density, rest.swapaxes(-1, -2)

    def _moved(
        self, at: integrals.NodeResponses, M: Modulator, component: NDArray[np.intp]
    ) -> tuple[FloatArray, FloatArray]:
        """Return the effects of random sources on u (N, m², R, G), and the densities (N, I, G, q) at images inside.

        `component` (I,) are those of the images inside.
        """
        N, R, m, _ = M.held.shape
        # The images of one component side by side (A, K), -1 where there are fewer.
        active, of_image = np.unique(component, return_inverse=True)
        side = np.full((len(active), int(np.bincount(of_image).max())), -1)
        for k in range(len(active)):
            own = np.flatnonzero(of_image == k)
            side[k, : len(own)] = own
        y = at.measured[:, side] * (side >= 0)[:, :, None, None]
        u = M.own[:, active, None] @ y
        signal = M.heard[:, active, None] @ y
        out = np.zeros((N, m * m, R, len(self.random)))
        for place, some in integrals.alike(M):
            seen = signal[..., place, :]
            alone = self._of_sources(seen[..., :, None, :] * seen[..., None, :, :].conj()).sum(axis=2)
            others = np.repeat(alone.sum(axis=1, keepdims=True), R, axis=1)
            others[:, active] = integrals.exclusive(alone, 1)
            out[:, :, some] = integrals.through(M.held[:, some], others[:, some])
            here = np.isin(active, some)
            u[:, here] += M.held[:, active[here], None] @ seen[:, here]
        each = self._of_sources(np.moveaxis(integrals.outer(u.swapaxes(-1, -2)), -1, 1))
        # Sums over the others, not the whole less its own: what feedback cancels would leave rounding.
        others = out[:, :, active, None] + integrals.exclusive(each, 3)
        out[:, :, active] += each.sum(axis=3)
        rows, columns = np.nonzero(side >= 0)
        order = np.argsort(side[rows, columns])
        rows, columns = rows[order], columns[order]
        return out, self._where_sources_are(at, u[:, rows, columns], others[:, :, rows, columns])

    def _where_sources_are(self, at: integrals.NodeResponses, u: ComplexArray, others: FloatArray) -> FloatArray:
        """Return the densities (N, I, G, q) at images that have sources of their own.

        Of controls u (N, I, m, c) that an image's own disturbance moves, and of what the `others` (N, m², I, G) move.
        """
        own = at.direct.copy()
        for r in range(self.plant.controls):
            own += at.held[..., r, None] * u[:, :, r, None, :]
        power = self._of_sources(own.real**2 + own.imag**2)
        aliased = at.outer[:, list(at.inside)] @ others.transpose(0, 2, 1, 3)
        return np.asarray((power + aliased).swapaxes(-1, -2))

    def _lines(self, controller: MultiRate, over_frequency: bool) -> list[integrals.Contribution]:
        """Return the lines of sines, those that add as they come together: of each alone, and last of all of them."""
        by_frequency: dict[object, list[hybrid.SineDisturbance]] = {}
        for one in self.sines:
            by_frequency.setdefault(one.frequency if one.phase is not None else id(one), []).append(one)
        groups = list(by_frequency.values())
        step = max(1, _MOST_AT_ONCE // ((2 * self.images + 1) * self.open_loop.size))
        return [
            line
            for k in range(0, len(groups), step)
            for line in self._lines_of(groups[k : k + step], controller, over_frequency)
        ]

    def _lines_of(
        self, groups: list[list[hybrid.SineDisturbance]], controller: MultiRate, over_frequency: bool
    ) -> list[integrals.Contribution]:
        plant, omega = self.plant, np.array([group[0].frequency for group in groups])
        # A line at a multiple of the controller's rate has an image at zero, to the last bit.
        still = plant.turn * np.round(omega / plant.turn)
        omega = np.where(np.abs(omega - still) <= _SAME * omega, still, omega)
        family = self.open_loop.family(omega, np.arange(-self.images, self.images + 1))
        M = self.open_loop.modulator(controller, omega, family.sampled)
        weights = self.weights(family.frequency)
        rest = self.open_loop.remaining_images(omega, family.held)
        hidden = (family.frequency == 0.0) & (self.lowest > 0.0)
        of_image = np.arange(-self.images, self.images + 1) % plant.cycle
        out = []
        for k, sines in enumerate(groups):
            amplitude = np.stack([one.vector(plant.disturbances) for one in sines], axis=-1)
            u = M.of(k, 0, family.measured[k, self.images] @ amplitude)
            with np.errstate(invalid="ignore"):
                z = family.held[k] @ u[of_image]
                z[self.images] += family.direct[k, self.images] @ amplitude
                z = np.where(hidden[k, :, None, None], 0.0, z * family.integral[k])
            if not np.isfinite(z).all():
                raise ArgumentError(
                    f"source {sines[0].name}: a sine at a multiple of a loop's sample frequency makes an angle drift "
                    "without bound; give the lowest frequency that counts"
                )
            z, u = (np.concatenate([one, one.sum(axis=-1, keepdims=True)], axis=-1) for one in (z, u))
            power = 0.5 * np.abs(z.swapaxes(-1, -2)) ** 2
            remaining = 0.5 * np.einsum("crg,cirs,csg->gi", u.conj(), rest[k], u).real
            variance = np.einsum("wf,fgi->wgi", weights[:, k], power)
            out.append(
                integrals.Contribution(
                    panels=np.array([[omega[k], omega[k]]]),
                    variance=variance[None],
                    error=np.zeros((1, *variance.shape)),
                    remaining=remaining[None],
                    steps=[(np.abs(family.frequency[k]), weights[0, k][:, None, None] * power)] * over_frequency,
                    sines=tuple(one.name for one in sines),
                )
            )
        return out
