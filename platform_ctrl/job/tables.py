"""The tables of a job file: which keys there are and what each may be on its own."""

from __future__ import annotations

from typing import Annotated, get_args

from pydantic import ConfigDict, Field

from platform_ctrl.job.faults import FAULT_KINDS
from platform_ctrl.job.job import LoopKind, Mode, Points, Structure
from platform_ctrl.job.methods import METHODS
from platform_ctrl.job.scenario import VibrationKind
from platform_ctrl.job.variation import Distribution
from platform_ctrl.plant import fields
from platform_ctrl.plant.fields import Table

# Tables of a kind in one array.
MOST = 1000
MOST_LOOPS, MOST_VIBRATIONS = 100, 20


class OperationTable(Table):
    """``[operation]``."""

    Omega: fields.Rates
    Omega_grid: fields.GridPoints = 2
    seed: fields.Seed = 0


class SpreadTable(Table):
    """``[spread]``."""

    inertia: fields.Share = 0.0
    spin: fields.Share = 0.0
    samples: fields.Samples = 0


class FaultsTable(Table):
    """``[faults]``."""

    slow_rotor: fields.Part | None = None
    weak_torquer: fields.SomePart | None = None


class SamplingTable(Table):
    """``[sampling]``."""

    rate_hz: fields.Frequency
    delay: fields.NotNegative


class LoopLimitsTable(Table):
    """``[loop.limits]``."""

    bandwidth_hz: fields.Positive | None = None
    disk_margin: fields.Positive | None = None
    sensitivity_peak: fields.Positive | None = None
    complementary_peak: fields.Positive | None = None
    damping: fields.Positive | None = None
    fastest_pole: fields.Positive | None = None
    tracking: fields.Positive | None = None
    tracking_hz: fields.Positive | None = None
    Omega_rejection: fields.Positive | None = None
    torque_rejection: fields.Positive | None = None
    torque_noise: fields.Positive | None = None
    torque_limit: fields.Positive | None = None
    torque_limit_hz: fields.Positive | None = None
    controller_poles: fields.Positive | None = None
    controller_gain: fields.Positive | None = None
    disk_margin_spread: fields.Positive | None = None
    sensitivity_peak_spread: fields.Positive | None = None
    complementary_peak_spread: fields.Positive | None = None
    damping_spread: fields.Positive | None = None
    disk_margin_faults: fields.Positive | None = None
    damping_faults: fields.Positive | None = None


class DesignTable(Table):
    """``[[loop.design]]``: every other key is a number for the method."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, fields.Number] = Field(init=False)

    name: fields.SystemName
    method: Annotated[str, fields.one_of(METHODS)]
    tune: fields.Truth = False
    structure: Annotated[Structure, fields.one_of(get_args(Structure))] | None = None


class LoopTable(Table):
    """``[[loop]]``."""

    name: fields.SystemName
    kind: Annotated[LoopKind, fields.one_of(get_args(LoopKind))]
    gimbals: fields.Names = ()
    use: fields.Text
    limits: LoopLimitsTable = Field(default_factory=LoopLimitsTable)
    soft: LoopLimitsTable = Field(default_factory=LoopLimitsTable)
    design: list[DesignTable] = Field(min_length=1, max_length=MOST_LOOPS)


class CoupledTable(Table):
    """``[coupled]``."""

    disk_margin: fields.Positive | None = None
    coupling_cost: fields.Positive | None = None


class ManoeuvreLimitsTable(Table):
    """``limits`` of a manoeuvre."""

    angle: fields.Positive | None = None
    attitude: fields.Positive | None = None
    torque_share: fields.Positive | None = None


class OmegaTable(Table):
    """``Omega_table`` of a manoeuvre."""

    t: fields.Times
    Omega1: fields.Numbers | None = None
    Omega2: fields.Numbers | None = None
    Omega3: fields.Numbers | None = None
    smooth: fields.Truth = False


class TorqueTable(Table):
    """``torque_table`` of a manoeuvre."""

    t: fields.Times
    M1: fields.Numbers | None = None
    M2: fields.Numbers | None = None
    M3: fields.Numbers | None = None
    smooth: fields.Truth = False


class InitialTable(Table):
    """``initial`` of a manoeuvre: keys are signals."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, fields.Number] = Field(init=False)


class VibrationTable(Table):
    """``[[manoeuvre.vibration]]``."""

    kind: Annotated[VibrationKind, fields.one_of(get_args(VibrationKind))]
    axis: fields.RootAxis
    frequencies_hz: fields.Frequencies
    densities: fields.Densities
    lines: fields.Lines = 64


class ManoeuvreTable(Table):
    """``[[manoeuvre]]``."""

    name: fields.Text
    mode: Annotated[Mode, fields.one_of(get_args(Mode))]
    axis: fields.RootAxis | None = None
    duration: fields.Positive
    rate: fields.NotZero | None = None
    rise: fields.Positive | None = None
    hold: fields.NotNegative | None = None
    torque: fields.NotZero | None = None
    Omega_table: OmegaTable | None = None
    torque_table: TorqueTable | None = None
    initial: InitialTable = Field(default_factory=InitialTable)
    faults: fields.Names = ()
    vibration: list[VibrationTable] = Field(default_factory=list, max_length=MOST_VIBRATIONS)
    limits: ManoeuvreLimitsTable = Field(default_factory=ManoeuvreLimitsTable)


class FaultTable(Table):
    """``[[fault]]``."""

    name: fields.Text
    kind: Annotated[str, fields.one_of(FAULT_KINDS)]
    part: fields.Text | None = None
    at: fields.NotNegative
    until: fields.Positive | None = None
    share: fields.NotNegative | None = None
    time_constant: fields.Positive | None = None
    amplitude: fields.Positive | None = None
    frequency_hz: fields.Positive | None = None
    rate: fields.NotZero | None = None
    probability: fields.SomePart | None = None
    impulse: fields.NotZero | None = None


class CampaignManoeuvreTable(Table):
    """``[[campaign.manoeuvre]]``."""

    name: fields.Text
    weight: fields.Positive = 1.0


class VaryTable(Table):
    """``[[campaign.vary]]``."""

    parameter: fields.Text
    distribution: Annotated[Distribution, fields.one_of(get_args(Distribution))]
    low: fields.Number | None = None
    high: fields.Number | None = None
    mean: fields.Number | None = None
    median: fields.Positive | None = None
    peak: fields.Number | None = None
    deviation: fields.Positive | None = None
    values: fields.Numbers | None = None
    weights: fields.Numbers | None = None
    relative: fields.Truth = False


class CampaignFaultTable(Table):
    """``[[campaign.fault]]``."""

    fault: fields.Text
    probability: fields.Part


class CampaignTable(Table):
    """``[campaign]``."""

    runs: fields.Runs = 1000
    seed: fields.Seed | None = None
    sampling: Annotated[Points, fields.one_of(get_args(Points))] = "sobol"
    step: fields.Positive = 1e-4
    manoeuvre: list[CampaignManoeuvreTable] = Field(default_factory=list, max_length=MOST)
    vary: list[VaryTable] = Field(default_factory=list, max_length=MOST)
    fault: list[CampaignFaultTable] = Field(default_factory=list, max_length=MOST)


class JobFile(Table):
    """The whole file."""

    schema_: fields.SchemaOne = Field(alias="schema")
    name: fields.Text
    plant: fields.Plant
    operation: OperationTable
    spread: SpreadTable = Field(default_factory=SpreadTable)
    faults: FaultsTable = Field(default_factory=FaultsTable)
    sampling: SamplingTable
    loop: list[LoopTable] = Field(min_length=1, max_length=MOST_LOOPS)
    coupled: CoupledTable = Field(default_factory=CoupledTable)
    manoeuvre: list[ManoeuvreTable] = Field(default_factory=list, max_length=MOST)
    fault: list[FaultTable] = Field(default_factory=list, max_length=MOST)
    campaign: CampaignTable | None = None
