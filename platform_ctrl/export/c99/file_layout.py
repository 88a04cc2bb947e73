"""The frame of generated files: comments, guards, structs, and the step that runs all controllers of a job."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

from platform_ctrl.export.c99.identifiers import comment
from platform_ctrl.export.c99.scheme import Provenance

# Columns of generated code.
WIDTH = 100


def provenance(origin: Provenance, whole: bool = False) -> list[str]:
    """Return lines that state where a controller comes from; with `whole` what all controllers of a job share."""
    design = f"{origin.design} (method {origin.method})" if origin.method else origin.design
    rows = [
        ("Job", origin.job),
        ("Plant", origin.plant),
        ("Loop", "" if whole else origin.loop),
        ("Design", "" if whole else design),
        ("Controllers", f"sha256 {origin.sha256}" if origin.sha256 else ""),
        ("Versions", ", ".join(f"{name} {number}" for name, number in origin.versions.items())),
        ("Made by", origin.command),
    ]
    return [f"{name + ':':<12} {text}" for name, text in rows if text]


def acts(period: float, delay: float) -> str:
    """Return a sentence about when outputs act, for times in s."""
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


_END_OF_NAMES = ["#ifdef __cplusplus", "}", "#endif", ""]


def header_file(prefix: str, head: Iterable[str], includes: Sequence[str], body: Iterable[str]) -> str:
    """Return the text of a header that may be included twice, and by C++; `includes` with their quotes or brackets."""
    guard = f"{prefix.upper()}_H"
    lines = [*head, f"#ifndef {guard}", f"#define {guard}", ""]
    if includes:
        lines += [*(f"#include {name}" for name in includes), ""]
    lines += ["#ifdef __cplusplus", 'extern "C" {', "#endif", "", *body, "", *_END_OF_NAMES]
    return "\n".join([*lines, f"#endif /* {guard} */", ""])


def struct(name: str, fields: Iterable[str]) -> list[str]:
    """Return the definition of a struct, ended by an empty line."""
    return [f"typedef struct {name} {{", *fields, f"}} {name};", ""]


def declared(prefix: str, reset: str, step: str) -> list[str]:
    """Return the declarations of the two functions of a controller, with what they do."""
    return [
        f"/* {reset} Call it before the first step. */",
        f"void {prefix}_reset({prefix}_state *state);",
        "",
        f"/* {step} */",
        *signature(prefix, ";"),
    ]


def job_header_file(
    prefix: str, head: Iterable[str], controllers: Sequence[str], inputs: Sequence[str], outputs: Sequence[str]
) -> str:
    """Return the text of the header that runs several controllers, given by their prefixes, in one step."""
    statuses = [f"    unsigned int {one}_status; /* what {one}_step returned */" for one in controllers]
    return header_file(
        prefix,
        head,
        [f'"{one}.h"' for one in controllers],
        [
            *struct(f"{prefix}_in", inputs),
            *struct(f"{prefix}_out", [*outputs, *statuses]),
            *struct(f"{prefix}_state", [f"    {one}_state {one};" for one in controllers]),
            *declared(
                prefix,
                "Resets every controller.",
                "One sample of all controllers; returns the sum of what applies to any of them (bits as there).",
            ),
        ],
    )


def job_source_file(
    prefix: str, helpers: Iterable[str], controllers: Sequence[str], wired: Sequence[tuple[list[str], list[str]]]
) -> str:
    """Return the text of the source file that belongs to `job_header_file`.

    `wired` has for every controller the statements before its step, which fill ``in_1``, ..., and those after it, which
    take from ``out_1``, ...
    """
    body = []
    for number, (one, (before, after)) in enumerate(zip(controllers, wired, strict=True), 1):
        body += [
            "",
            f"    /* {number}. {one} */",
            *before,
            f"    out->{one}_status = {one}_step(&state->{one}, &in_{number}, &out_{number});",
            f"    status |= out->{one}_status;",
            *after,
        ]
    return "\n".join(
        [
            *block([f"{prefix}.c: all controllers of a job. See {prefix}.h. Generated; do not edit."]),
            f'#include "{prefix}.h"',
            "",
            *helpers,
            f"void {prefix}_reset({prefix}_state *state)",
            "{",
            *(f"    {one}_reset(&state->{one});" for one in controllers),
            "}",
            "",
            *signature(prefix),
            "{",
            "    unsigned int status = 0U;",
            *(f"    {one}_{way} {way}_{k};" for k, one in enumerate(controllers, 1) for way in ("in", "out")),
            *body,
            "",
            "    return status;",
            "}",
            "",
        ]
    )
