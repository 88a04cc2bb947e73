"""What a job file says of simulated runs, as values: manoeuvres, faults, the campaign."""

from __future__ import annotations

import math

import numpy as np

from platform_ctrl.job import Campaign, CampaignFault, CampaignManoeuvre, Manoeuvre
from platform_ctrl.reading.job_tables import (
    CampaignTable,
    FaultTable,
    ManoeuvreTable,
    OmegaTable,
    TorqueTable,
    VaryTable,
    VibrationTable,
)
from platform_ctrl.scenario import Fault, TimeTable, Vibration
from platform_ctrl.variation import CENTRES, DISTRIBUTION_NUMBERS, Vary


def manoeuvre(table: ManoeuvreTable) -> Manoeuvre:
    """Return a manoeuvre; what moves nothing is zero."""
    return Manoeuvre(
        name=table.name,
        mode=table.mode,
        axis=table.axis or 1,
        duration=table.duration,
        rate=table.rate or 0.0,
        rise=table.rise or 0.0,
        hold=table.hold or 0.0,
        torque=table.torque or 0.0,
        Omega_table=None if table.Omega_table is None else _time_table(table.Omega_table),
        torque_table=None if table.torque_table is None else _time_table(table.torque_table),
        vibrations=tuple(_vibration(one) for one in table.vibration),
        faults=table.faults,
        initial=dict(table.initial.model_extra or {}),
        limits=table.limits.model_dump(exclude_none=True),
    )


def _time_table(table: OmegaTable | TorqueTable) -> TimeTable:
    columns = (
        (table.Omega1, table.Omega2, table.Omega3) if isinstance(table, OmegaTable) else (table.M1, table.M2, table.M3)
    )
    still = (0.0,) * len(table.t)
    values = np.array([still if column is None else column for column in columns]).T
    return TimeTable(t=np.array(table.t), values=values, smooth=table.smooth)


def _vibration(table: VibrationTable) -> Vibration:
    return Vibration(
        kind=table.kind,
        axis=table.axis,
        frequencies_hz=np.array(table.frequencies_hz),
        densities=np.array(table.densities),
        lines=table.lines,
    )


def fault(table: FaultTable) -> Fault:
    """Return a fault; numbers that its kind does not need keep their defaults."""
    given = table.model_dump(exclude_none=True)
    return Fault(**({"until": math.inf} | given))


def campaign(table: CampaignTable, seed: int) -> Campaign:
    """Return the campaign; `seed` is the job's own."""
    return Campaign(
        runs=table.runs,
        seed=seed if table.seed is None else table.seed,
        sampling=table.sampling,
        step=table.step,
        manoeuvres=tuple(CampaignManoeuvre(name=one.name, weight=one.weight) for one in table.manoeuvre),
        vary=tuple(_vary(one) for one in table.vary),
        faults=tuple(CampaignFault(fault=one.fault, probability=one.probability) for one in table.fault),
    )


def _vary(table: VaryTable) -> Vary:
    numbers = {}
    for key in DISTRIBUTION_NUMBERS[table.distribution]:
        number = getattr(table, key)
        # What is needed was looked for; a centre that is left out is that of factors.
        numbers[key] = 1.0 if number is None and key in CENTRES else number
    return Vary(
        parameter=table.parameter,
        distribution=table.distribution,
        numbers=numbers,
        values=table.values or (),
        weights=table.weights or (),
        relative=table.relative,
    )
