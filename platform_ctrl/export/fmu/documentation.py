"""The page inside the unit that importing tools show as its documentation."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from platform_ctrl.export.fmu.signals import Signal, inputs_of, outputs_of, parameters_of, runs_of
from platform_ctrl.job import Job

_STYLE = (
    "body{font:15px/1.45 system-ui,sans-serif;max-width:60em;margin:2em auto;padding:0 1em}"
    "table{border-collapse:collapse;margin:.5em 0 1.5em}"
    "th,td{text-align:left;padding:.15em 1.2em .15em 0;border-bottom:1px solid #ccc}"
    "code{font:13px ui-monospace,monospace}"
)


def page(job: Job, run: int, version: str, hashes: dict[str, str]) -> str:
    """Return the documentation of a unit as HTML: what it needs, how it is stepped, its variables."""
    period = job.sampling.period
    runs = "".join(f"<li>{escape(name)}</li>" for name in runs_of(job))
    sums = [(name, f"<code>{number}</code>") for name, number in hashes.items()]
    return f"""<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><title>{escape(job.name)}</title><style>{_STYLE}</style></head>
<body>
<h1>{escape(job.name)}</h1>
<p>{escape(job.platform.name)}: the non-linear plant with its sampled controllers. It runs in a Python with the package
platform_ctrl, version {version}, on the machine of the importing tool.</p>
<p>A communication step is a whole number of sample periods of {period!r} s; any other is discarded. Torques are held
over a step. A platform rate is a straight line over it: Omega at its beginning, then the slope Omega_rate, 0 if it is
held.</p>
<h2>Values of the parameter manoeuvre</h2>
<ol>{runs}</ol>
<h2>Parameters</h2>
{_signals(parameters_of(job, run))}
<h2>Inputs</h2>
{_signals(inputs_of(job))}
<h2>Outputs</h2>
{_signals(outputs_of(job))}
<h2>Made of</h2>
{_table(("file", "SHA-256"), sums)}
</body>
</html>
"""


def _signals(signals: Sequence[Signal]) -> str:
    rows = [
        (
            f"<code>{escape(one.name)}</code>",
            escape(one.unit),
            "" if one.start is None else str(one.start).lower(),
            escape(one.description),
        )
        for one in signals
    ]
    return _table(("name", "unit", "start", ""), rows)


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{one}</th>" for one in heads)
    body = "\n".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table>\n<tr>{head}</tr>\n{body}\n</table>"
