"""Valid arguments of every public call, in one table: what the contract test starts from.

A new public function needs an entry in `FUNCTIONS` (or `METHODS`, by class); a new public class one in `INSTANCES`.
"""

from __future__ import annotations

import functools
import tempfile
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import control
import numpy as np

import platform_ctrl as pc
from one_gyro_job import JOB as ONE_LOOP
from one_gyro_runs import MANOEUVRES
from platform_ctrl import analysis, campaign, design, export, simulation, verification
from platform_ctrl.analysis import certificates
from platform_ctrl.analysis.arrays import StateArrays, state_arrays
from platform_ctrl.analysis.certificates.makers import stability_certificate
from platform_ctrl.analysis.loop_metrics import measure
from platform_ctrl.analysis.plant_set import PlantSet
from platform_ctrl.campaign.planning import Plan
from platform_ctrl.campaign.summary import Summary
from platform_ctrl.design.antiwindup.loop import LimitedLoop
from platform_ctrl.design.classical.complex_coordinates import ComplexSystem
from platform_ctrl.design.classical.complex_shaping import ComplexLoop
from platform_ctrl.design.classical.crossover import CrossoverDesign
from platform_ctrl.design.jobs import LoopOutcome
from platform_ctrl.design.lmi.scheduled import Scheduled
from platform_ctrl.export.job_systems import model_systems
from platform_ctrl.job.budget import Budget, Source
from platform_ctrl.job.job import Job
from platform_ctrl.job.requirements import requirement
from platform_ctrl.job.spectra import SineSpectrum
from platform_ctrl.job.variation import ANY
from platform_ctrl.mechanics.parameter_varying import ParameterVaryingModel
from platform_ctrl.mechanics.precession.result import Precession
from platform_ctrl.simulation.closed_loop import Trajectory
from platform_ctrl.verification import baselines
from platform_ctrl.verification.baselines.file import write_baseline
from platform_ctrl.verification.baselines.record import Baseline, Tolerance
from vehicle_log import FILE as VEHICLE_LOG

PERIOD = 0.0005
W = np.array([1.0, 10.0, 100.0])
TEXT = """
[campaign]
runs = 4

[[campaign.vary]]
parameter = "rotor.11.spin"
distribution = "normal"
mean = 1.0
deviation = 0.01
relative = true
"""


@functools.cache
def platform() -> pc.Platform:
    return pc.read_platform("three_gyro_platform")


@functools.cache
def model() -> pc.LinearModel:
    return pc.linearise(platform())


@functools.cache
def pair() -> control.StateSpace:
    return pc.state_space(model(), gimbals=("9", "10"))


@functools.cache
def crossover() -> CrossoverDesign:
    return design.from_crossover_and_margin(model(), ("9", "10"), crossover_hz=8.0, disk_margin=0.5, period=PERIOD)


def plant() -> control.StateSpace:
    return crossover().plant


def controller() -> control.StateSpace:
    return crossover().controller


def one(dt: float = 0.0) -> control.StateSpace:
    """A stable system of two states, one input, one output."""
    return control.ss([[-0.5, 0.1], [0.0, -0.2]], [[0.0], [1.0]], [[1.0, 0.0]], 0.0, dt)


def general(noise: bool = True) -> control.StateSpace:
    """A plant w, u -> z, y that every synthesis takes: two states, one control, one measurement, with noise or not."""
    A, B1, B2 = [[0.0, 1.0], [-1.0, -0.2]], [[0.0, 0.0], [1.0, 0.0]], [[0.0], [1.0]]
    C = [[1.0, 0.0], [0.0, 0.0], [1.0, 0.0]]
    D = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, float(noise), 0.0]]
    return control.ss(A, np.hstack([B1, B2]), C, D)


def matrices(K: bool = False) -> dict[str, Any]:
    names = ("A_K", "B_K", "C_K", "D_K") if K else ("A", "B", "C", "D")
    return dict(zip(names, ([[-0.5, 0.1], [0.0, -0.2]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]]), strict=True))


def arrays(dt: float = 0.0) -> StateArrays:
    return state_arrays(one(dt), "")


@functools.cache
def asked() -> Job:
    return pc.read_job(tomllib.loads(ONE_LOOP + MANOEUVRES + TEXT))


@functools.cache
def outcomes() -> tuple[LoopOutcome, ...]:
    return design.loops(asked())


def closed() -> control.StateSpace:
    return outcomes()[0].closed.controller


def plants() -> PlantSet:
    found = outcomes()[0].closed.plants
    assert found is not None
    return found


@functools.cache
def result() -> verification.JobResult:
    return verification.check_job(asked(), outcomes())


@functools.cache
def baseline() -> Baseline:
    return baselines.accepted(result())


@functools.cache
def planned() -> Plan:
    return campaign.plan(asked(), [closed()])


def table() -> dict[str, Any]:
    from campaign_runs import invented_columns, planned

    return invented_columns(planned(), range(64))


@functools.cache
def summary() -> Summary:
    from campaign_runs import planned

    return campaign.summarise(planned(), table())


@functools.cache
def scenario() -> simulation.Scenario:
    return simulation.Scenario(platform=platform(), mode="caged", duration=0.002, delay=0.0)


def source() -> Source:
    return Source(name="sway", kind="base-rate", axis=1, spectrum=SineSpectrum(sines=np.array([[1.0, 0.1, 0.0]])))


@functools.cache
def varying() -> ParameterVaryingModel:
    return pc.parameter_varying(platform(), gimbals=("9", "10"))


@functools.cache
def coordinates() -> ComplexSystem:
    return design.complex_plant(model(), ("9", "10"), balance=True)


@functools.cache
def shaped() -> ComplexLoop:
    return design.complex_loop(
        coordinates(), crossover_hz=8.0, integral_hz=1.0, damping_hz=30.0, lead_hz=20.0, rolloff_hz=2000.0
    )


@functools.cache
def limited() -> LimitedLoop:
    from limited_response import loop

    return loop()


@functools.cache
def precession() -> Precession:
    return pc.precession(model(), gimbals=("9", "10"))


def certificate() -> certificates.Certificate:
    return stability_certificate([[-1.0, 0.0], [0.0, -2.0]])


def measured() -> control.FRD:
    w = np.geomspace(0.1, 1e4, 400)
    return control.FRD(1.0 / (1.0 + 1j * w) / (1.0 + 0.01j * w), w)


def trajectory() -> Trajectory:
    return result().runs[0].trajectory


def stepper() -> simulation.Simulator:
    return simulation.Simulator(scenario(), [], period=PERIOD)


def limit() -> Any:
    return requirement("disk margin", 0.4)


@functools.cache
def file(kind: str) -> Path:
    folder = Path(tempfile.mkdtemp())
    match kind:
        case "baseline":
            return write_baseline(baseline(), folder / "baseline.json")
        case "mat":
            export.write_mat(model_systems(asked()), folder / "systems.mat")
            return folder / "systems.mat"
        case "mjcf":
            export.write_mjcf(platform(), folder / "plant.xml")
            return folder / "plant.xml"
        case "csv":
            return export.write_responses(measured(), folder / "response.csv")
        case "controllers":
            return export.write_controllers([closed()], folder / "controllers.json", delay=PERIOD)
    return export.write_systems(model_systems(asked()), folder / "systems.json")


Q, V = [0.0] * 5, [0.1] * 8
CALL = {"P": general, "nmeas": lambda: 1, "ncon": lambda: 1}
POINT = {"platform": platform, "q": lambda: Q, "velocity": lambda: V}
JOINED = {"plant": plant, "controller": controller}
NEW = {"path": lambda: Path("new")}  # in the folder that the caller chose


def of(**given: Any) -> dict[str, Callable[[], Any]]:
    """Arguments as they are, each made anew by a call."""
    return {name: (lambda item=item: item) for name, item in given.items()}


FUNCTIONS: dict[str, dict[str, Callable[[], Any]]] = {
    "figures.Omega_sensitivity": {"plant": pair},
    "figures.bode": {"systems": one},
    "figures.campaign_histograms": {"campaign": summary},
    "figures.campbell": {"platform": platform, **of(gimbals=("9", "10"))},
    "figures.disk_margin_region": of(margins=0.5),
    "figures.gang_of_four": {"plant": plant, "controllers": controller},
    "figures.gimbal_tree": {"platform": platform},
    "figures.nichols": {"loops": one},
    "figures.nyquist": {"loops": one},
    "figures.pole_map": {"systems": one},
    "figures.root_locus": {"plant": plant, "controller": controller},
    "figures.root_locus_over_spin": {
        "platform": platform,
        "controller": controller,
        **of(gimbals=("9", "10"), period=PERIOD),
    },
    "figures.singular_values": {"systems": one},
    "figures.step_response": {"systems": one},
    "figures.time_run": {"run": trajectory, "platform": platform},
    "figures.two_sided_nyquist": {"curve": lambda: shaped().nyquist},
    "element_forces": POINT,
    "equations": {"platform": platform},
    "forward_dynamics": POINT | of(force=[0.0] * 8),
    "inverse_dynamics": POINT | of(acceleration=[0.0] * 8),
    "linearise": {"platform": platform},
    "matrices": POINT,
    "parameter_varying": {"platform": platform, **of(gimbals=("9", "10"))},
    "precession": {"model": model, **of(gimbals=("9", "10"))},
    "read_job": {"source": lambda: tomllib.loads(ONE_LOOP)},
    "read_platform": of(source="rate_gyro"),
    "rotor_momenta": POINT,
    "state_space": {"model": model, **of(gimbals=("9", "10"))},
    "subsystems": {"model": model},
    "terms": {"platform": platform, **of(Omega=[0.1, 0.0, 0.0], rates=[0.01] * 5)},
    "with_free_rotors": POINT,
    "with_regulated_rotors": POINT,
    "with_rotors_as_gimbals": {"platform": platform},
    "analysis.bandwidth": JOINED,
    "analysis.closed_loop": JOINED,
    "analysis.damping": {"system": one},
    "analysis.disk_margin": {"loop_transfer": one},
    "analysis.frequency_response": {"system": one, **of(frequency=W)},
    "analysis.gang": JOINED | of(frequency=W),
    "analysis.h2_norm": {"system": one},
    "analysis.hinf_norm": {"system": one, **of(tolerance=1e-9)},
    "analysis.intersample_h2": CALL | {"P": lambda: general(False), "K": lambda: one(0.1)},
    "analysis.intersample_norm": CALL | {"P": lambda: general(False), "K": lambda: one(0.1)},
    "analysis.loop_margins": JOINED,
    "analysis.loop_transfer": JOINED,
    "analysis.noise_rms": {"system": lambda: one(0.1), **of(rms=[1.0])},
    "analysis.sampled": {"system": one, **of(period=0.1)},
    "analysis.time_response": {"system": one, **of(timepts=[0.0, 0.1, 0.2], inputs=[[0.0, 1.0, 1.0]])},
    "baselines.accepted": {"result": result},
    "baselines.compare": {"result": result, "baseline": baseline},
    "baselines.read_baseline": {"path": lambda: file("baseline")},
    "baselines.update_baseline": {"result": result, **NEW},
    "campaign.plan": {"job": asked, "controllers": lambda: [closed()]},
    "campaign.rerun": {"plan": planned, **of(number=0)},
    "campaign.run_campaign": {"plan": planned, **of(folder="runs")},
    "campaign.summarise": {"plan": planned, "table": table},
    "verification.check_job": {"job": asked, "loops": outcomes},
    "verification.read_controllers": {"source": lambda: file("controllers"), "job": asked},
    "design.anti_windup": {"loop": limited},
    "design.caging_largest_Omega": {"job": asked, "controller": closed},
    "design.complex_loop": {
        "plant": coordinates,
        **of(crossover_hz=8.0, integral_hz=1.0, damping_hz=30.0, lead_hz=20.0, rolloff_hz=2000.0),
    },
    "design.complex_plant": {"model": model, **of(gimbals=("9", "10"), balance=True)},
    "design.from_crossover_and_margin": {
        "model": model,
        **of(gimbals=("9", "10"), crossover_hz=8.0, disk_margin=0.5, period=PERIOD),
    },
    "design.h2": CALL,
    "design.hinf": CALL,
    "design.limited_loop": {"plant": pair, "controller": controller, **of(disturbance="Omega1", limits=0.5)},
    "design.loops": {"job": asked},
    "design.lqe": {"system": general, **of(R1=np.eye(2), R2=np.eye(3))},
    "design.lqg": {"system": one, **of(Q1=np.eye(2), Q2=np.eye(1), R1=np.eye(2), R2=np.eye(1))},
    "design.lqr": {"system": general, **of(Q1=np.eye(2), Q2=np.eye(3))},
    "design.measured_pid": {"measurement": measured, **of(filter_time=0.01)},
    "design.multiobjective": CALL | {"requirements": lambda: [norm_limit()]},
    "design.pole_placement": {"system": one, **of(poles=[-1.0, -2.0])},
    "design.read_measurement": {"source": lambda: file("csv")},
    "design.robust": of(nmeas=1, ncon=1) | {"plants": lambda: [general()], "requirements": lambda: [norm_limit()]},
    "design.sampled_hinf": CALL | {"P": lambda: general(False), **of(period=0.01)},
    "design.scheduled": of(plant=lambda p: general(), names=("a",), low=[0.0], high=[1.0], nmeas=1, ncon=1),
    "design.scheduled_caging": {"platform": platform, **of(gimbals=("9", "10"), bandwidth_hz=8.0)},
    "design.structured": {"plants": general, **of(nmeas=1, ncon=1, structure=design.Static(), starts=1)},
    "design.largest_Omega": {"loop": limited},
    "export.system_record": {"system": one},
    "export.read_mat": {"path": lambda: file("mat")},
    "export.read_mjcf": {"path": lambda: file("mjcf")},
    "export.read_systems": {"path": lambda: file("json")},
    "export.write_c": {"job": asked, "entries": lambda: [closed()], **of(folder="code")},
    "export.write_controllers": {"controllers": lambda: [closed()], **NEW, **of(delay=PERIOD)},
    "export.write_mat": {"systems": lambda: model_systems(asked()), **NEW},
    "export.write_mjcf": {"platform": platform, **NEW},
    "export.write_responses": {"response": measured, **NEW},
    "export.write_systems": {"systems": lambda: model_systems(asked()), **NEW},
    "platform_source": of(name="rate_gyro"),
    "report.prepared": {"result": result},
    "report.write_page": {"result": result, **NEW},
    "requirements.requirement": of(kind="disk margin", limit=0.4),
    "simulation.simulate": {"scenario": scenario, "controllers": list, **of(period=PERIOD)},
    "simulation.simulate_batch": {"scenarios": lambda: [scenario()], "controllers": list, **of(period=PERIOD)},
    "simulation.rollout": {"platform": platform, **of(q=[Q] * 2, velocity=[V] * 2, step=1e-4, steps=2, every=1)},
    "simulation.Simulator": {"scenario": scenario, "controllers": list, **of(period=PERIOD)},
    "testing.assert_baseline": {"result": result, "file": lambda: file("baseline")},
    "testing.assert_requirements": {"result": result},
}


def norm_limit() -> Any:
    return requirement("H-infinity norm", 10.0, channel=analysis.Channel())


# One valid value of each public class: its constructor's arguments, and what its methods are called on.
INSTANCES: dict[str, Callable[[], Any]] = {
    "Cage": lambda: pc.Cage(gimbal="4", stiffness=1.0),
    "Erection": lambda: pc.Erection(gimbal="4", senses="5", axis=np.array([0.0, 1.0, 0.0]), gain=0.1),
    "Friction": lambda: pc.Friction(gimbal="4", viscous=1e-3, coulomb=(1e-3, 1e-3), breakaway=(2e-3, 2e-3)),
    "Gimbal": lambda: platform().gimbals[0],
    "Job": asked,
    "LinearModel": model,
    "parameter_varying.ParameterVaryingModel": varying,
    "PickOff": lambda: platform().pickoffs[0],
    "Platform": platform,
    "result.Precession": precession,
    "RateSensor": lambda: pc.RateSensor(name="rate", root_axis=1),
    "Rotor": lambda: platform().rotors[0],
    "Spring": lambda: pc.Spring(gimbal="4", stiffness=1.0),
    "term_table.TermTable": lambda: pc.terms(platform(), Omega=(1, 1, 1), rates=[0.01] * 5),
    "Torquer": lambda: platform().torquers[0],
    "Unbalance": lambda: pc.Unbalance(body="4", moment=np.array([0.0, 0.0, 1e-3])),
    "analysis.Channel": analysis.Channel,
    "analysis.DiskMargin": lambda: analysis.disk_margin(one()),
    "loop_metrics.LoopMetrics": lambda: measure(plants(), state_arrays(closed(), "")),
    "plant_set.PlantSet": plants,
    "record.LoopMatrices": lambda: baseline().loops[0],
    "record.Tolerance": Tolerance,
    "table_statistics.CampaignStatistics": lambda: summary().statistics,
    "planning.Plan": planned,
    "summary.Summary": summary,
    "certificates.Certificate": certificate,
    "certificates.ClosedLoop": lambda: certificate().loops[0],
    "verification.JobResult": result,
    "design.Lead": design.Lead,
    "scheduled.Scheduled": lambda: scheduled(),
    "caging.ScheduledCaging": lambda: design.scheduled_caging(
        platform(), ("9", "10"), Omega_max=(5, 5, 5), bandwidth_hz=40, terms="paper"
    ),
    "loop.LimitedLoop": limited,
    "design.Notch": design.Notch,
    "design.PID": design.PID,
    "design.Series": lambda: design.Series(blocks=[design.PID(), design.Notch()]),
    "design.StateSpaceOrder": lambda: design.StateSpaceOrder(states=2),
    "design.Static": design.Static,
    "parameter_varying.AffineModel": lambda: varying().affine(),
    "part.PrecessionPart": lambda: precession().part("9"),
    "requirements.LoopRequirement": limit,
    "requirements.LoopRequirement.check_closed_loop": lambda: requirement("damping", 0.1),
    "requirements.LoopRequirement.check_controller": lambda: requirement("controller gain", 0.1),
    "simulation.Fault": lambda: simulation.Fault(name="lost", kind="torquer weak", part="Q9", at=0.1, share=0.5),
    "budget.Budget": lambda: Budget(from_hz=1.0, to_hz=9.0, sources=(source(),)),
    "budget.Source": source,
    "simulation.Simulator": stepper,
    "simulation.HalfCosine": lambda: simulation.HalfCosine(axis=1, rate=1.0, rise=0.1, hold=0.1),
    "simulation.Scenario": scenario,
    "simulation.TimeTable": lambda: simulation.TimeTable(t=np.array([0.0, 1.0]), values=np.zeros((2, 3))),
    "simulation.Vibration": lambda: simulation.Vibration(
        kind="rate", axis=1, frequencies_hz=np.array([10.0, 20.0]), densities=np.array([1e-6, 1e-6])
    ),
    "variation.Range": lambda: ANY,
}


@functools.cache
def scheduled() -> Scheduled:
    return design.scheduled(lambda p: general(), ("Omega1",), [0.0], [1.0], 1, 1)


METHODS: dict[str, dict[str, Callable[[], Any]]] = {
    "Job.every": {"spec": lambda: asked().loops[0]},
    "Job.period_of": {"spec": lambda: asked().loops[0]},
    "Friction.dry": of(rate=0.1),
    "parameter_varying.ParameterVaryingModel.at": of(Omega=[0.1, 0.0, 0.0]),
    "parameter_varying.ParameterVaryingModel.forcing": of(Omega=[0.1, 0.0, 0.0]),
    "parameter_varying.ParameterVaryingModel.grid": of(points=2, Omega_max=[0.1, 0.0, 0.0]),
    "parameter_varying.ParameterVaryingModel.rhs": of(t=0.0, x=np.zeros(4), Omega=np.zeros(3), Q=np.zeros(2)),
    "parameter_varying.ParameterVaryingModel.state": of(q=[0.0, 0.1], rates=[0.0, 0.0], Omega=[0.0, 0.0, 1.0]),
    "parameter_varying.ParameterVaryingModel.state_space": of(Omega=[0.1, 0.0, 0.0]),
    "parameter_varying.ParameterVaryingModel.vertices": of(Omega_max=[0.1, 0.0, 0.0]),
    "PickOff.sampled_noise": of(period=PERIOD),
    "PickOff.signals": {"platform": platform},
    "RateSensor.sampled_noise": of(period=PERIOD),
    "RateSensor.signals": {"platform": platform},
    "Platform.body": of(name="4"),
    "Platform.gimbal": of(name="4"),
    "Platform.pickoff_on": of(gimbal="9"),
    "Platform.torquer_on": of(gimbal="9"),
    "result.Precession.error": of(frequency=W),
    "result.Precession.state_space": of(momentum_states=False),
    "result.Precession.part": of(gimbal="9"),
    "term_table.TermTable.text": of(gimbals=("9",)),
    "term_table.TermTable.of": of(gimbal="9"),
    "analysis.Channel.of": {"system": arrays, **of(inputs=["u"], outputs=["y"])},
    "loop_metrics.LoopMetrics.values": {"request": limit},
    "loop_metrics.LoopMetrics.of": of(groups=("nominal",)),
    "plant_set.PlantSet.finer": of(frequency=W),
    "plant_set.PlantSet.joined": {"controller": closed},
    "plant_set.PlantSet.of": of(groups=("nominal",)),
    "plant_set.PlantSet.only": of(chosen=[0]),
    "plant_set.PlantSet.system": of(k=0),
    "record.LoopMatrices.agrees": {"other": lambda: baseline().loops[0]},
    "record.LoopMatrices.same_controller": {"other": lambda: baseline().loops[0]},
    "record.LoopMatrices.same_plant": {"other": lambda: baseline().loops[0]},
    "record.Tolerance.allowed": of(accepted=1.0),
    "table_statistics.CampaignStatistics.of": of(requirement="angle", manoeuvre="turn"),
    "planning.Plan.inputs": of(first=0, last=2),
    "planning.Plan.inputs_at": {"points": lambda: np.full((1, planned().dimensions), 0.5)},
    "planning.Plan.points": of(first=0, last=2),
    "planning.Plan.scenario": of(run=0),
    "planning.Plan.scenarios": of(first=0, last=2),
    "planning.Plan.scenarios_with": {"inputs": lambda: planned().inputs(0, 2), **of(runs=[0, 1])},
    "summary.Summary.inputs_of": of(run=0),
    "certificates.Certificate.verify": of(precision=128),
    "scheduled.Scheduled.at": of(parameters=[0.5]),
    "scheduled.Scheduled.controller": of(Omega=[0.5, 0.5, 0.5]),
    "scheduled.Scheduled.plant": of(parameters=[0.5]),
    "loop.LimitedLoop.impulse": of(control="torque"),
    "caging.ScheduledCaging.controller": of(Omega=[0.5, 0.5, 0.5]),
    "part.PrecessionPart.error": of(frequency=W),
    "parameter_varying.AffineModel.state_matrix": of(parameters=[0.1] + [0.0] * 5),
    "parameter_varying.AffineModel.system": of(parameters=[0.1] + [0.0] * 5),
    "requirements.LoopRequirement.check": {"plants": plants, "controller": closed},
    "requirements.LoopRequirement.check_closed_loop": {"closed_loop": lambda: one(PERIOD)},
    "requirements.LoopRequirement.check_controller": {"controller": closed},
    "requirements.LoopRequirement.values": {"metrics": INSTANCES["loop_metrics.LoopMetrics"]},
    "requirements.LoopRequirement.ratios": {"metrics": INSTANCES["loop_metrics.LoopMetrics"]},
    "requirements.LoopRequirement.result": {"plants": plants, "metrics": INSTANCES["loop_metrics.LoopMetrics"]},
    "budget.Budget.density": of(f_hz=[1.0, 2.0]),
    "budget.Source.density": of(f_hz=[1.0, 2.0]),
    "budget.Source.rms": of(from_hz=1.0, to_hz=2.0),
    "simulation.TimeTable.at": of(t=[0.5]),
    "simulation.TimeTable.from_log": of(path=VEHICLE_LOG, columns=("gyro_z", None, None), factor=1.0),
    "simulation.Simulator.advance": of(samples=1),
    "simulation.Simulator.restore": {"snapshot": lambda: stepper().snapshot()},
    "variation.Range.holds": of(low=0.1, high=0.2, continuous=True),
}
# Their arguments come from the search, not from a user.
STRUCTURES = ("block", "order", "parameters")
