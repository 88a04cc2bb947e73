"""What a change of form must not change: values and texts made through the public surface, kept in tests/frozen/.

    python tests/frozen.py [PART ...]            makes the parts anew, prints what differs; exit code 1 if anything does
    python tests/frozen.py --strict [PART ...]   searches too to 1e-9: for one machine and BLAS, before and after a move
    python tests/frozen.py --write [PART ...]    accepts the parts as they are

Only the command line and public names are used, so that it runs on while what is behind them moves. Every part returns
nested values; they are kept flat, one line each, by their path. Numbers are kept to 12 digits. See frozen/README.md.
"""

from __future__ import annotations

import argparse
import contextlib
import difflib
import io
import json
import math
import os
import re
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import control
import numpy as np

import platform_ctrl as pc
from platform_ctrl import analysis, design, simulation
from platform_ctrl.cli import main as command

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "tests" / "frozen"
JOB = ROOT / "examples" / "three_gyro_platform.toml"
MODELS = sorted(path.stem for path in (ROOT / "models").glob("*.toml"))
PROBLEMS = {
    name: problem
    for file in ("compleib.json", "compleib-hard.json")
    for name, problem in json.loads((ROOT / "tests" / "data" / file).read_text(encoding="utf-8"))["problems"].items()
}

EXACT = 1e-9  # relative, of what is computed without a search
# Entries of a matrix are found to rounding errors of its largest: those that are zero but for them are not compared.
MATRIX_FLOOR = 1e-12
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?(?!\w)")
# What depends on the machine, on versions, or on the bytes of a file; sections, which multiply
# out to the matrices; matrices X that only witness a proof.
DROPPED = {"versions", "sha256", "identity", "sections"}
SCRUBBED = (
    (re.compile(r" \* Versions:.*\n(?: \*   .*\n)*"), ""),
    (re.compile(r"\{?[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12}\}?"), "TOKEN"),
    (re.compile(r"\b[0-9a-f]{64}\b"), "SHA256"),
    (re.compile(r"_[0-9a-f]{12}\b"), "_HASH"),
    (re.compile(r'(generationTool|generationDateAndTime| version)="[^"]*"'), r'\1=""'),
)

Flat = dict[str, Any]


@dataclass(frozen=True)
class Part:
    """A part: how it is made, and by how much what matches a pattern may differ: relative, absolute; first match.

    What matches `minimised` may be less by any amount: a search ended in a better minimum.
    """

    make: Callable[[], Any]
    tolerances: tuple[tuple[str, float, float], ...] = ()
    minimised: str | None = None
    slow: bool = False

    def tolerance(self, path: str, strict: bool) -> tuple[float, float]:
        found = next(((rel, floor) for pattern, rel, floor in self.tolerances if re.search(pattern, path)), None)
        rel, floor = found or (EXACT, 0.0)
        return (min(rel, EXACT), min(floor, 1e-9)) if strict else (rel, floor)


def rounded(value: float) -> float:
    return float(f"{value:.12g}")


def lines(text: str) -> list[str]:
    """A text without what depends on the machine, its numbers rounded."""
    for pattern, by in SCRUBBED:
        text = pattern.sub(by, text)

    def short(found: re.Match[str]) -> str:
        return repr(rounded(float(found[0]))) if re.search(r"[.eE]", found[0]) else found[0]

    return NUMBER.sub(short, text).splitlines()


def flat(value: Any, path: str = "") -> Flat:
    """Nested values by their paths; arrays of numbers and the lines of a text stay together."""
    if isinstance(value, Mapping):
        if {"A", "B", "C", "D"} <= set(value) and isinstance(value["A"], list):
            value = dict(value) | {key: np.array(value[key], dtype=float) for key in "ABCD"}
        pairs = [(str(key), one) for key, one in value.items() if key not in DROPPED]
    elif isinstance(value, np.ndarray):
        if np.iscomplexobj(value):
            return flat({"re": value.real, "im": value.imag}, path)
        return {path: np.vectorize(rounded, otypes=[float])(value).tolist()}
    elif isinstance(value, list | tuple):
        if not value or all(isinstance(one, str) for one in value):
            return {path: list(value)}
        if all(isinstance(one, int | float) and not isinstance(one, bool) for one in value):
            return flat(np.array(value, dtype=float), path)
        pairs = [(str(k), one) for k, one in enumerate(value)]
    elif isinstance(value, float | np.floating):
        return {path: rounded(float(value))}
    elif isinstance(value, str):
        return {path: lines(value) if "\n" in value else "".join(lines(value))}
    else:
        return {path: value}
    return {key: one for name, inner in pairs for key, one in flat(inner, f"{path}/{name}".lstrip("/")).items()}


def differences(before: Flat, after: Flat, part: Part, strict: bool = False) -> Iterator[str]:
    """What differs, a line each."""
    for path in before | after:
        rel, floor = part.tolerance(path, strict)
        if rel == math.inf:
            continue
        if path not in before or path not in after:
            yield f"{path}: {'new' if path in after else 'gone'}"
            continue
        old, new = before[path], after[path]
        if old == new or (part.minimised and not strict and re.search(part.minimised, path) and new < old):
            continue
        if numeric(old) and numeric(new):
            yield from apart(path, np.asarray(old, dtype=float), np.asarray(new, dtype=float), rel, floor)
            continue
        texts = [[one] if isinstance(one, str) else one for one in (old, new)]
        if not all(isinstance(one, list) and all(isinstance(line, str) for line in one) for one in texts):
            yield f"{path}: {old!r} was expected, {new!r} found"
            continue
        bare = [[NUMBER.sub("#", line) for line in one] for one in texts]
        if bare[0] != bare[1]:
            for line in list(difflib.unified_diff(*bare, lineterm="", n=0))[2:22]:
                yield f"{path}: {line}"
            continue
        for k, (was, now) in enumerate(zip(*texts, strict=True), 1):
            pair = [np.array([float(one) for one in NUMBER.findall(line)]) for line in (was, now)]
            yield from apart(f"{path}, line {k}", *pair, rel, max(floor, MATRIX_FLOOR))


def numeric(value: Any) -> bool:
    try:
        return not isinstance(value, bool | str | None) and np.asarray(value).dtype.kind in "iuf"
    except ValueError:
        return False


def apart(path: str, old: Any, new: Any, rel: float, floor: float) -> Iterator[str]:
    """Say where numbers are further apart than they may be: the worst of an array."""
    if old.shape != new.shape:
        yield f"{path}: shape {old.shape} was expected, {new.shape} found"
        return
    if not old.size:
        return
    finite = np.abs(old[np.isfinite(old)])
    floor = max(floor, MATRIX_FLOOR * finite.max(initial=0.0)) if old.size > 1 else floor
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.where(old == new, 0.0, np.abs(new - old) / (floor + rel * np.maximum(np.abs(old), np.abs(new))))
    off = np.where(np.isnan(old) & np.isnan(new), 0.0, np.where(np.isnan(off), np.inf, off))
    k = np.unravel_index(int(np.argmax(off)), off.shape)
    if off[k] > 1.0:
        change = abs(new[k] - old[k]) / max(abs(old[k]), abs(new[k]))
        yield f"{path}{list(map(int, k)) or ''}: {old[k]:.12g} was expected, {new[k]:.12g} found, relative {change:.1e}"


def kept(name: str) -> Flat:
    found: Flat = json.loads((DATA / f"{name}.json").read_text(encoding="utf-8"))
    return found


def keep(name: str, values: Flat) -> None:
    """Write a part: a line a value, and a line for every line of a text."""

    def shown(value: Any) -> str:
        if isinstance(value, list) and len(value) > 1 and all(isinstance(one, str) for one in value):
            return "[\n" + ",\n".join(json.dumps(one, ensure_ascii=False) for one in value) + "]"
        return json.dumps(value, ensure_ascii=False, separators=(",", ":"))

    text = "{\n" + ",\n".join(f"{json.dumps(key)}: {shown(value)}" for key, value in values.items()) + "\n}\n"
    (DATA / f"{name}.json").write_text(text, encoding="utf-8")


def run(*arguments: str) -> tuple[int, str]:
    """Exit code and standard output of a command; progress on standard error is left out."""
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as said:
        code = command(arguments)
    if code not in (0, 1):
        raise RuntimeError(f"platform-ctrl {' '.join(arguments)}: exit code {code}\n{said.getvalue()}")
    return code, out.getvalue()


def answer(*arguments: str) -> dict[str, Any]:
    """What a command prints with --json, and its exit code."""
    code, out = run(*arguments, "--json")
    found = json.loads(out)
    for one in found.get("controllers", ()) if "requirements" in found else ():
        one.pop("bounds", None)  # of a search that ends at a share of 1e-3
    return {"exit code": code, "json": found}


@contextlib.contextmanager
def folder() -> Iterator[Path]:
    """A folder to work in, named nowhere in what is written there: the job, and frozen controllers for it."""
    with tempfile.TemporaryDirectory() as name, contextlib.chdir(name):
        Path("job.toml").write_text(JOB.read_text(encoding="utf-8"), encoding="utf-8")
        saved = DATA / "controllers.json"
        if saved.exists():
            values = json.loads(saved.read_text(encoding="utf-8"))
            Path("job.controllers.json").write_text(json.dumps(values), encoding="utf-8")
        yield Path(name)


# The parts, from what takes no time to what takes most.


def equations() -> dict[str, Any]:
    return {
        "text": {name: run("equations", name)[1] for name in MODELS},
        "latex": run("equations", "three_gyro_platform", "--format", "latex")[1],
        "exact": run("equations", "rate_gyro", "--terms", "exact", "--order", "exact")[1],
        "exact terms, json": answer("equations", "gyro_horizon", "--terms", "exact", "--order", "2"),
        "python": str(pc.equations(pc.read_platform("rate_gyro"), form="sympy")),
    }


def mechanics() -> dict[str, Any]:
    """Matrices, dynamics, linear models and motion of every shipped plant at a state in no special place."""
    out: dict[str, Any] = {"models": answer("models")}
    for name in MODELS:
        platform = pc.read_platform(name)
        n = len(platform.gimbal_names)
        q, velocity = 0.003 * np.cos(np.arange(n)), 0.1 * np.sin(1.0 + np.arange(3 + n))
        model, m = pc.linearise(platform, Omega=(0.1, 0.2, -0.1)), pc.matrices(platform, q, velocity)
        moved = simulation.rollout(platform, q=[q], velocity=[velocity * 0.1], step=1e-4, steps=100)
        out[name] = {
            "matrices": {key: np.asarray(getattr(m, key)) for key in ("A", "A_star", "A_R", "B", "L", "G_A", "G_R")},
            "inverse": np.asarray(pc.inverse_dynamics(platform, q, velocity, np.cos(np.arange(3 + n)))),
            "forward": np.asarray(pc.forward_dynamics(platform, q, velocity, 0.01 * np.cos(np.arange(3 + n)))),
            "subsystems": [list(group) for group in pc.subsystems(model)],
            "paper": system(pc.state_space(pc.linearise(platform, terms="paper"))),
            "exact": system(pc.state_space(model)),
            "free root": system(pc.state_space(model, root="free")),
            "rollout": {key: np.asarray(getattr(moved, key)) for key in ("q", "velocity", "attitude")},
        }
    platform = pc.read_platform("three_gyro_platform")
    slow = pc.precession(pc.linearise(platform), gimbals=("9", "10"))
    varying = pc.parameter_varying(platform).state_space([0.1, 0.2, -0.1])
    return out | {
        "terms": pc.terms(platform, Omega=(1, 1, 1), rates=[0.01] * 5).text(),
        "precession": system(slow.state_space()),
        "parameter varying": system(varying),
    }


def system(sys: control.StateSpace) -> dict[str, Any]:
    names = {"inputs": sys.input_labels, "outputs": sys.output_labels, "states": sys.state_labels}
    return names | {key: np.asarray(getattr(sys, key)) for key in "ABCD"}


def random_plant(n: int, seed: int, direct: bool) -> control.StateSpace:
    """A plant with one unstable pole or pair, four w and z, two u and y."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() - 0.3) * np.eye(n)
    D = 0.5 * rng.normal(size=(6, 6))
    D[4:, 4:] = 0.0
    if not direct:
        D[:4, :4] = 0.0
    return control.ss(A, rng.normal(size=(n, 6)), rng.normal(size=(6, n)), D)


def linear_systems() -> dict[str, Any]:
    """Norms, margins and responses."""
    out: dict[str, Any] = {}
    for n in (6, 16, 30):
        P = random_plant(n, 3, True)
        P = control.ss(P.A - 1.5 * np.eye(n), P.B, P.C, P.D)
        low = control.ss(P.A, P.B[:, :3], P.C[:3], 0)
        margin = analysis.disk_margin(0.02 * low)
        w, t = np.geomspace(0.01, 100.0, 20), np.linspace(0.0, 5.0, 21)
        norm, peak = analysis.hinf_norm(P)
        out[str(n)] = {
            "hinf_norm": norm,
            "peak": peak,
            "h2_norm": float(analysis.h2_norm(low)),
            "disk_margin": {"lower": margin.lower, "upper": margin.upper},
            "frequency_response": analysis.frequency_response(low, w),
            "time_response": np.asarray(analysis.time_response(low, t, np.array([np.sin(t), t, np.cos(t)]))),
        }
    return out


def compleib(name: str) -> tuple[control.StateSpace, int, int]:
    p = {k: np.array(PROBLEMS[name][k], dtype=float) for k in ("A", "B1", "B", "C1", "C", "D11", "D12", "D21")}
    D = np.block([[p["D11"], p["D12"]], [p["D21"], np.zeros((len(p["C"]), p["B"].shape[1]))]])
    B, C = np.hstack([p["B1"], p["B"]]), np.vstack([p["C1"], p["C"]])
    plant = control.StateSpace(p["A"], B, C, D, remove_useless_states=False)
    return plant, len(p["C"]), p["B"].shape[1]


def synthesis() -> dict[str, Any]:
    """Full order: what the closed loops have and the bounds beneath."""
    out: dict[str, Any] = {}
    for n in (6, 10, 15):
        r = design.hinf(random_plant(n, 0, True), 2, 2, method="riccati")
        h2 = design.h2(random_plant(n, 0, False), 2, 2)
        out[f"random, {n}"] = {"hinf": {"gamma": r.gamma, "gamma_optimal": r.gamma_optimal}, "h2": h2.gamma}
    lmi = design.hinf(random_plant(4, 0, True), 2, 2, method="lmi")
    out["lmi, 4"] = {"gamma": lmi.gamma, "gamma_optimal": lmi.gamma_optimal}
    return out


def static_gains(starts: int, evaluations: int, names: tuple[str, ...]) -> dict[str, Any]:
    """Static output feedback on problems of COMPleib: the norm reached, and the bound of full order."""
    out = {}
    for name in names:
        r = design.structured(*compleib(name), structure=design.Static(), starts=starts, evaluations=evaluations)
        out[name] = {"gamma": r.gamma, "gamma_optimal": r.gamma_optimal}
    return out


def saved_controllers() -> dict[str, Any]:
    """Controllers of the shipped job: what check, simulate, campaign and export are given. Only --write makes them."""
    with folder():
        found = answer("design", "job.toml", "-o", "out")["json"]
    keys = ("name", "design", "method", "dt", "A", "B", "C", "D", "inputs", "outputs", "delay")
    found = {"schema": 1, "controllers": [{key: one[key] for key in keys} for one in found["controllers"]]}
    out: dict[str, Any] = json.loads(json.dumps(found), parse_float=lambda text: rounded(float(text)))
    return out


def export() -> dict[str, Any]:
    """All forms, of the frozen controllers."""
    import scipy.io

    with folder() as here:
        forms = ["--c", "c", "--mat", "all.mat", "--models", "all.json", "--csv", "csv", "--mjcf", "plant.xml"]
        said = answer("export", "job.toml", *forms)
        texts = {str(f.relative_to(here)): f.read_text(encoding="utf-8") for f in sorted(here.glob("*/*.[ch]"))}
        csv = {f.name: f.read_text(encoding="utf-8").splitlines() for f in sorted(Path("csv").glob("*.csv"))}
        return {
            "json": said,
            "c": texts,
            "csv": {name: "\n".join([*rows[:4], *rows[4::40]]) for name, rows in csv.items()},
            "models": json.loads(Path("all.json").read_text(encoding="utf-8")),
            "mat": {k: plain(v) for k, v in scipy.io.loadmat("all.mat", simplify_cells=True).items() if k[0] != "_"},
            "mjcf": Path("plant.xml").read_text(encoding="utf-8"),
        }


def plain(value: Any) -> Any:
    """What scipy.io reads, as mappings, lists and arrays of numbers."""
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, np.ndarray) and value.dtype.kind not in "fiuc":
        return [plain(one) for one in value.ravel().tolist()]
    return value


def flights() -> dict[str, Any]:
    """A campaign of a few runs, its table, and single runs, with the frozen controllers."""
    import pyarrow.parquet

    with folder():
        said = answer("campaign", "job.toml", "--runs", "8", "--workers", "1", "-o", "campaign")
        table = pyarrow.parquet.read_table("campaign/campaign.parquet").to_pydict()
        return {
            "campaign": said,
            "table": {name: column for name, column in table.items() if "seconds" not in name},
            "run 3": answer("simulate", "job.toml", "--run", "3", "-o", "campaign"),
            "manoeuvre 1": answer("simulate", "job.toml", "--manoeuvre", "1"),
        }


def checked() -> dict[str, Any]:
    """The verdicts on the frozen controllers."""
    with folder():
        found = answer("check", "job.toml", "-o", "check")
    return found


def verdicts(result: Mapping[str, Any]) -> Flat:
    return flat({key: result[key] for key in ("passed", "requirements", "coupled", "runs")})


def round_trip(job: str) -> dict[str, Any]:
    """What design says, and whether check says the same of the controllers that it wrote."""
    made = answer("design", job, "-o", "out")
    again = answer("check", job, "--controllers", "out/result.json", "-o", "check")
    # Where a peak lies is found to the root of what its height is found to.
    close = ((r"/frequency$", 1e-6, 0.0), (".*", EXACT, 1e-12))
    differ = list(differences(verdicts(made["json"]), verdicts(again["json"]), Part(dict, close)))
    return made | {"check differs from design": differ}


def small_jobs() -> dict[str, Any]:
    """Two jobs as `new` copies them, designed and checked."""
    out = {}
    for kind in ("caged-gyro", "control-moment-gyro"):
        with folder():
            out[kind] = {"new": answer("new", "small", "--kind", kind)} | round_trip("small.toml")
    return out


def shipped_job() -> dict[str, Any]:
    with folder():
        return round_trip("job.toml")


# Why each is wider than 1e-9 stands in frozen/README.md, with what other BLAS kernels moved.
ONLY_STRICT = math.inf
DESIGNED = (
    (r"/([A-D]|margin|evidence|frequency|cost|signal)$|/claims/|/options/|/loop_by_loop/", ONLY_STRICT, 0.0),
    (r"/(value|lower|upper|largest_pole_radius)$", 0.2, 1e-3),
)
MEASURED = ((r"/claims/largest Omega", 1e-7, 0.0), (r"/(cost|margin)$", EXACT, 1e-9))
GAINS = {"tolerances": ((r"/gamma$", 1e-2, 0.0), (r"/gamma_optimal$", 1.5e-3, 0.0)), "minimised": r"/gamma$"}
PARTS = {
    "equations": Part(equations),
    "mechanics": Part(mechanics),
    # Where a maximum lies is found to the root of the rounding errors only.
    "linear": Part(linear_systems, ((r"/peak$", 1e-7, 0.0),)),
    # An interior-point solver ends where its tolerance is met; a nearly cancelling response has fewer digits.
    "synthesis": Part(synthesis, ((r"^lmi", 1e-3, 0.0),)),
    "export": Part(export, ((r"^csv/", 1e-7, 0.0),)),
    "flights": Part(flights),
    "static-quick": Part(partial(static_gains, 2, 1000, ("AC15", "NN2", "NN8")), **GAINS),
    "small": Part(small_jobs, DESIGNED, slow=True),
    "check": Part(checked, MEASURED, slow=True),
    "static": Part(
        partial(static_gains, 8, 10000, ("AC2", "AC3", "AC17", "HE2", "REA2", "PSM", "NN16")), **GAINS, slow=True
    ),
    "shipped": Part(shipped_job, DESIGNED, slow=True),
}


def made(part: Part) -> Flat:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return flat(part.make())


def main() -> int:
    """Compare or write the parts that are named, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(['controllers', *PARTS])}; default: all")
    parser.add_argument("--write", action="store_true", help="accept the parts as they are")
    parser.add_argument("--strict", action="store_true", help="compare searches to 1e-9, too")
    asked = parser.parse_args()
    if unknown := set(asked.parts) - {"controllers", *PARTS}:
        parser.error(f"no part is called {', '.join(sorted(unknown))}")
    if "controllers" in asked.parts and asked.write:
        (DATA / "controllers.json").write_text(json.dumps(saved_controllers(), indent=None) + "\n", encoding="utf-8")
    count = 0
    for name, part in PARTS.items():
        if asked.parts and name not in asked.parts:
            continue
        began = time.process_time()
        values = made(part)
        if asked.write:
            keep(name, values)
            found = []
        else:
            found = list(differences(kept(name), values, part, asked.strict))
        print(f"{name}: {len(values)} values, {len(found)} differ, {time.process_time() - began:.1f} s", flush=True)
        for line in found:
            print(f"  {line}")
        count += len(found)
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
