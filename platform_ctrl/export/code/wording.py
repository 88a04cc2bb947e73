"""What the comments of generated code say, and lines that all of it has alike."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from platform_ctrl.export.code.identifiers import comment
from platform_ctrl.export.code.scheme import Provenance

# Columns of generated code.
WIDTH = 100


def provenance(origin: Provenance, whole: bool = False) -> list[str]:
    """Return lines that say where a controller comes from; with `whole` what all controllers of a job share."""
    design = f"{origin.design} (method {origin.method})" if origin.method else origin.design
    said = [
        ("Job", origin.job),
        ("Plant", origin.plant),
        ("Loop", "" if whole else origin.loop),
        ("Design", "" if whole else design),
        ("Controllers", f"sha256 {origin.sha256}" if origin.sha256 else ""),
        ("Versions", ", ".join(f"{name} {number}" for name, number in origin.versions.items())),
        ("Made by", origin.command),
    ]
    return [f"{name + ':':<12} {text}" for name, text in said if text]


def acts(period: float, delay: float) -> str:
    """Return a sentence that says when outputs act, for times in s."""
    if delay == 0.0:
        return "The outputs act at the instant of the sample and are held until the next ones act."
    share = delay / period
    when = f", {share:.6g} of a period" if abs(share - 1.0) > 1e-9 else ", with the next sample"
    return (
        f"The outputs act {delay:.9g} s after the sample{when}: not sooner, not later; they are held until the next "
        "ones act."
    )


def block(paragraphs: Sequence[str]) -> list[str]:
    """Return a comment of several paragraphs as lines; an empty one is an empty line."""
    lines = ["/*"]
    for paragraph in paragraphs:
        text = comment(paragraph) if paragraph else ""
        # A label's column is kept.
        label, _, rest = paragraph.partition(":")
        if paragraph.startswith(label + ":") and rest[:2] == "  ":
            text = f"{comment(label)}:{' ' * (len(rest) - len(rest.lstrip()))}{comment(rest)}"
        lines += [f" * {line}".rstrip() for line in textwrap.wrap(text, WIDTH - 3, subsequent_indent="  ") or [""]]
    return [*lines, " */"]


def remark(text: str, indent: str) -> list[str]:
    """Return a short comment as lines."""
    lines = textwrap.wrap(comment(text), WIDTH - len(indent) - 6)
    if len(lines) == 1:
        return [f"{indent}/* {lines[0]} */"]
    return [f"{indent}/* {lines[0]}", *(f"{indent} * {line}" for line in lines[1:-1]), f"{indent} * {lines[-1]} */"]


def field(kind: str, name: str, what: str) -> str:
    """Return a field of a struct with a comment."""
    return f"    {kind} {name}; /* {comment(what)} */"


def signature(prefix: str, end: str = "") -> list[str]:
    """Return the head of a step function, an argument a line where they do not fit on one."""
    head, *arguments = (
        f"unsigned int {prefix}_step(",
        f"{prefix}_state *state",
        f"const {prefix}_in *in",
        f"{prefix}_out *out",
    )
    line = f"{head}{', '.join(arguments)}){end}"
    if len(line) <= WIDTH:
        return [line]
    return [head, *(f"    {one}," for one in arguments[:-1]), f"    {arguments[-1]}){end}"]
