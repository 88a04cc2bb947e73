"""Forces in a platform besides torquers: springs, friction, cages, unbalance, erection. Values only; SI units.

Their torques are part of Q in eq. (11); `platform_ctrl.mechanics.forces` evaluates them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from platform_ctrl.common.values import input_value, replaced
from platform_ctrl.plant import fields
from platform_ctrl.plant.fields import Refers
from platform_ctrl.plant.mistakes import Misfit, given, useless, wrong


@input_value
class Spring:
    """A spring between a gimbal and its parent: Q = −stiffness (q − rest).

    Attributes
    ----------
    gimbal
        Name of the gimbal.
    stiffness
        Torque per angle, N m/rad; negative where a field or a flexure drives the gimbal away.
    rest
        Angle at which it is relaxed, rad.
    damping
        Torque per rate of the spring that a servo's own loop is, N m s.
    """

    gimbal: Annotated[fields.Text, Refers()]
    stiffness: fields.NotZero
    rest: fields.Number = 0.0
    damping: float = 0.0


@input_value
class Friction:
    """Friction in a gimbal's bearing, dry and viscous: Q = −viscous q̇ − F.

    The level of the dry friction is the Stribeck curve dry(q̇) = coulomb + (breakaway − coulomb) exp(−(q̇ /
    stribeck_rate)²): as bodies begin to slide on each other friction falls from the breakaway torque to the Coulomb
    torque. F follows one of three laws:

    - It sticks: F = dry(q̇) sign(q̇) while sliding. At rest F balances all other torques up to `breakaway`, and the
      gimbal does not move at all.
    - With `coulomb_rate` it is smooth, F = dry(q̇) tanh(q̇ / coulomb_rate): a small torque makes the gimbal creep.
    - With `bristle_stiffness` σ0 it is elastic before it slides (LuGre): F = σ0 z + σ1 ż with the deflection z of the
      bristles, ż = q̇ − α σ0 |q̇| z / dry(q̇) and α = 1. Under a load that vibrates below breakaway it drifts. With
      `elastoplastic` α is 0 until |z| exceeds 85 % of dry/σ0 and whenever q̇ z < 0, and it stays where it is.

    Attributes
    ----------
    gimbal
        Name of the gimbal.
    viscous
        Torque per rate, N m s; σ2 of LuGre.
    coulomb
        Dry friction of fast sliding against negative and against positive rates, N m, both >= 0.
    coulomb_rate
        Rate at which a smooth dry friction has reached tanh(1) = 76 % of its full size, rad/s; 0: it is not smooth.
    breakaway
        Dry friction at the start of sliding, N m, the same way; not less than `coulomb`, which stands in where it would
        be.
    stribeck_rate
        Rate at which 1/e of the difference is left, rad/s. Infinite: there is no Stribeck curve, and `breakaway` is
        `coulomb`.
    bristle_stiffness, bristle_damping
        σ0, N m/rad, and σ1, N m s; 0: no bristles.
    elastoplastic
        Whether deflections of the bristles below 85 % of breakaway are elastic.

    References
    ----------
    C. Canudas de Wit, H. Olsson, K. J. Åström, P. Lischinsky, IEEE Trans. Automatic Control 40, 1995; P. Dupont,
    V. Hayward, B. Armstrong, F. Altpeter, IEEE Trans. Automatic Control 47, 2002.
    """

    gimbal: Annotated[fields.Text, Refers()]
    viscous: fields.NotNegative = 0.0
    coulomb: fields.Coulomb = (0.0, 0.0)
    coulomb_rate: fields.NotNegative = 0.0
    breakaway: fields.Coulomb = (0.0, 0.0)
    stribeck_rate: fields.Positive = math.inf
    bristle_stiffness: fields.NotNegative = 0.0
    bristle_damping: fields.NotNegative = 0.0
    elastoplastic: fields.Truth = False

    @staticmethod
    def _misfits(table: Mapping[str, Any]) -> Iterator[Misfit]:
        for key, other in (("breakaway", "stribeck_rate"), ("stribeck_rate", "breakaway")):
            if key in table and other not in table:
                yield useless(table, key, f'without "{other}"; give both')
        dry = table.get("coulomb", 0.0)
        pairs = zip(fields.coulomb(table.get("breakaway", dry)), fields.coulomb(dry), strict=True)
        if any(low < high for low, high in pairs):
            yield wrong(table, "breakaway", f"at least coulomb, {given(dry)}, to either side")
        if not table.get("bristle_stiffness"):
            for key in ("bristle_damping", "elastoplastic"):
                if table.get(key):
                    yield useless(table, key, 'without "bristle_stiffness"')
        elif table.get("coulomb_rate"):
            yield useless(table, "coulomb_rate", 'with "bristle_stiffness", which makes the friction smooth itself')
        elif min(fields.coulomb(dry)) == 0.0:
            yield wrong(table, "coulomb", "> 0 to either side, with bristles")

    def __post_init__(self) -> None:
        """Let `breakaway` follow a `coulomb` that `dataclasses.replace` has changed, too."""
        raised = self.coulomb
        if math.isfinite(self.stribeck_rate):
            raised = (max(self.breakaway[0], self.coulomb[0]), max(self.breakaway[1], self.coulomb[1]))
        object.__setattr__(self, "breakaway", raised)

    def linear(self, viscous: float) -> Friction:
        """Return the friction with more viscous friction, N m s, in the place of its dry part."""
        return replaced(self, {"viscous": self.viscous + viscous, "coulomb": (0.0, 0.0), "breakaway": (0.0, 0.0)})

    @property
    def law(self) -> Literal["viscous", "sticking", "smooth", "bristles", "elastoplastic"]:
        """What the dry part does near standstill."""
        if max(self.breakaway) == 0.0:
            return "viscous"
        if self.bristle_stiffness:
            return "elastoplastic" if self.elastoplastic else "bristles"
        return "smooth" if self.coulomb_rate else "sticking"

    def dry(self, rate: float) -> float:
        """Return the dry part of the friction torque while the gimbal turns steadily, without its minus sign.

        Parameters
        ----------
        rate
            Rate of the gimbal, rad/s.

        Returns
        -------
        float
            N m.
        """
        side = 0 if rate < 0.0 else 1
        left = math.exp(-((rate / self.stribeck_rate) ** 2)) if abs(rate) < 30.0 * self.stribeck_rate else 0.0
        level = self.coulomb[side] + (self.breakaway[side] - self.coulomb[side]) * left
        if self.coulomb_rate:
            return level * math.tanh(rate / self.coulomb_rate)
        return level * ((rate > 0.0) - (rate < 0.0))

    @property
    def steepest_slope(self) -> float:
        """The largest |∂Q/∂q̇| at any rate, N m s, or a bound a little above it: it limits the step of integration.

        Smooth dry friction rises most steeply where sliding begins, with breakaway / coulomb_rate, bristles with their
        damping. Where the Stribeck curve falls, it does so by (breakaway − coulomb) √(2/e) / stribeck_rate at most,
        against the viscous friction.
        """
        rising = self.viscous + self.bristle_damping
        if self.coulomb_rate:
            rising += max(self.breakaway) / self.coulomb_rate
        drop = max(self.breakaway[0] - self.coulomb[0], self.breakaway[1] - self.coulomb[1])
        falling = math.sqrt(2.0 / math.e) * drop / self.stribeck_rate - self.viscous
        return max(rising, falling)


@input_value
class Cage:
    """A mechanical cage that is closed: it holds a gimbal by a stiff, damped contact on both sides of an angle.

    With no clearance Q = −stiffness (q − angle) − damping q̇. With clearance nothing acts while |q − angle| is less;
    beyond it the contact pushes back with stiffness times the penetration and damping q̇, and never pulls.

    Attributes
    ----------
    gimbal
        Name of the gimbal.
    stiffness, damping
        Of the contact, N m/rad and N m s.
    clearance
        Free play to either side, rad.
    angle
        Middle of the cage, rad.
    """

    gimbal: Annotated[fields.Text, Refers()]
    stiffness: fields.Positive
    damping: fields.NotNegative = 0.0
    clearance: fields.NotNegative = 0.0
    angle: fields.Number = 0.0


@input_value
class Unbalance:
    """A body whose centre of mass does not lie at the fixed point: the specific force f turns it by −(m r) × f.

    The body's inertia is that about the fixed point, so that nothing else changes.

    Attributes
    ----------
    body
        Name of the gimbal or of the root, rotors included.
    moment : (3,)
        Mass times offset of the centre of mass from the fixed point, body axes, kg m.
    """

    body: Annotated[fields.Text, Refers(root=True)]
    moment: fields.Vector


@input_value
class Erection:
    """An erecting device: it senses the direction of specific force and torques a gimbal.

    Q = gain s·f/|f|, not beyond ± limit: s·f/|f| is the sine of the tilt of the sensing axis s out of the plane
    that is normal to the specific force f. Zero where f is zero.

    Attributes
    ----------
    gimbal
        Name of the gimbal that is torqued.
    senses
        Name of the body that carries the sensor.
    axis : (3,)
        Sensing axis s, a unit vector in that body's axes; dimensionless.
    gain
        N m per unit of the sine of the tilt.
    limit
        Largest torque, N m, or None.
    """

    gimbal: Annotated[fields.Text, Refers()]
    senses: Annotated[fields.Text, Refers(root=True)]
    axis: fields.Axis
    gain: fields.NotZero
    limit: fields.Positive | None = None

    @property
    def most(self) -> float:
        """The largest torque, N m; infinite for any."""
        return math.inf if self.limit is None else self.limit
