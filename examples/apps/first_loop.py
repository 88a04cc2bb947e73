"""A caged gyro under one's hands: sliders for the loop and the plant, with Bode, Nichols, step and poles beside them.

marimo edit examples/apps/first_loop.py     with the code
marimo run examples/apps/first_loop.py      the sliders alone
python examples/apps/first_loop.py          runs it once, as the tests do
"""

import marimo

app = marimo.App(width="full", app_title="A caged gyro")


@app.cell
def _():
    import tomllib

    import control
    import marimo as mo
    import numpy as np

    import platform_ctrl as pc
    from platform_ctrl.job.requirements import requirement
    from platform_ctrl.report import figures

    return control, figures, mo, np, pc, requirement, tomllib


@app.cell
def _(mo):
    mo.md("""
    # A caged gyro

    Gimbals 9 and 10 of the three-gyro platform. The loop acts across: the angle of one axis drives the torquer of the
    other. A lead from each angle to its own torquer damps nutation. Try what is bought from what: push the crossover up
    until damping is lost, get it back with the lead, and see what the delay leaves of the margin.
    """)
    return


@app.cell
def _(mo):
    crossover = mo.ui.slider(10, 120, step=1, value=40, label="crossover, Hz", show_value=True)
    lead = mo.ui.slider(0, 150, step=1, value=48, label="direct-axis lead, Hz", show_value=True)
    spin = mo.ui.slider(0.3, 1.7, step=0.05, value=1.0, label="rotor speed / nominal", show_value=True)
    delay = mo.ui.slider(0.0, 2.0, step=0.05, value=0.5, label="delay, ms", show_value=True)
    rate = mo.ui.slider(1000, 8000, step=250, value=2000, label="sample rate, Hz", show_value=True)
    mo.sidebar([mo.md("**Loop**"), crossover, lead, delay, rate, mo.md("**Plant**"), spin], width="19rem")
    return crossover, delay, lead, rate, spin


@app.cell
def _(control, np, pc, tomllib):
    def gyro_with(speed):
        """Return the platform with rotor 11 at another speed: a plant is a dict as well."""
        plant = tomllib.loads(pc.platform_source("three_gyro_platform"))
        for rotor in plant["rotor"]:
            if rotor["name"] == "11":
                rotor["angular_momentum"] *= speed
        return pc.read_platform(plant)

    def loop_with(crossover_hz, lead_hz, rate_hz):
        """Return torque = K(angle), sampled by Tustin's rule, for the nominal rotor: PI across, lead along."""
        model = pc.linearise(pc.read_platform("three_gyro_platform"))
        place = [model.platform.gimbal_names.index(gimbal) for gimbal in ("9", "10")]
        h, (J1, J2) = model.G[place[0], place[1]], np.diag(model.M)[place]
        s = control.tf("s")
        across = h * 2 * np.pi * crossover_hz * (1 + 2 * np.pi * 2 / s)
        along = 2 * np.pi * lead_hz * (s + 2 * np.pi * 7) / (s / (2 * np.pi * 0.4 * rate_hz) + 1)
        parts = control.append(*(control.ss(part) for part in (across, across, J1 * along, 1.2 * J2 * along)))
        angles = control.ss([], [], [], [[0, 1], [1, 0], [1, 0], [0, 1]])
        torques = control.ss([], [], [], [[-1, 0, -1, 0], [0, 1, 0, -1]])
        K = control.sample_system(torques * parts * angles, 1 / rate_hz, method="bilinear")
        return control.ss(K, inputs=["alpha9", "beta10"], outputs=["Q9", "Q10"])

    return gyro_with, loop_with


@app.cell
def _(crossover, delay, gyro_with, lead, loop_with, np, pc, rate, spin):
    period = 1.0 / rate.value
    controller = loop_with(crossover.value, lead.value, rate.value)
    platform = gyro_with(spin.value)
    gyro = pc.state_space(pc.linearise(platform), gimbals=("9", "10"))[["alpha9", "beta10"], ["Q9", "Q10"]]
    plant = pc.analysis.sampled(gyro, period, 1e-3 * delay.value, [2e-4, 2e-4])
    closed = pc.analysis.closed_loop(plant, controller)
    loop = pc.analysis.loop_transfer(plant, controller)
    stable = bool((np.abs(closed.poles()) < 1.0).all())
    return closed, controller, loop, period, plant, stable


@app.cell
def _(closed, controller, loop, np, pc, plant, requirement, stable):
    limits = {"disk margin": 0.5, "damping": 0.1, "bandwidth": 25.0}
    poles = pc.analysis.damping(closed)
    counted = (poles.natural_frequency > 50.0) | (poles.ratio < 0.0)
    measured = {
        "disk margin": float(pc.analysis.disk_margin(loop)) if stable else 0.0,
        "damping": float(poles.ratio[counted].min()),
        "bandwidth": pc.analysis.bandwidth(plant, controller) / (2 * np.pi) if stable else 0.0,
    }
    verdict = [
        requirement(kind, limit).judge(measured[kind], subject="gyro 9-10", stage="decoupled", evidence="this page")
        for kind, limit in limits.items()
    ]
    return (verdict,)


@app.cell
def _(mo, stable, verdict):
    rows = "\n".join(
        f"| {one.name} | {one.value:.3g} {one.unit} | ≥ {one.limit:g} {one.unit} | {'✓' if one.passed else '✗'} |"
        for one in verdict
    )
    told = "" if stable else "\n\n**The closed loop is not stable.**"
    mo.md(f"| figure | value | asked | met |\n| --- | --- | --- | --- |\n{rows}{told}")
    return


@app.cell
def _(closed, figures, loop, mo, stable):
    disturbed = closed[["alpha9", "beta10"], ["Q9", "Q10"]]
    plots = {
        "Bode": figures.bode(loop).figure,
        "Nichols": figures.nichols(loop).figure,
        "Step": figures.step_response(disturbed).figure if stable else None,  # a torque on each gimbal to the angles
        "Poles": figures.pole_map(closed).figure,
    }
    shown = [plot if plot is not None else mo.md("No step response: not stable.") for plot in plots.values()]
    mo.vstack([mo.hstack(shown[:2], widths="equal"), mo.hstack(shown[2:], widths="equal")], gap=1)
    return (plots,)


if __name__ == "__main__":
    app.run()
