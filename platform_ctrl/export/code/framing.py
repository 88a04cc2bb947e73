"""What generated files have around their contents: guards, and how the controllers of a job stand side by side."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from platform_ctrl.export.code.scheme import Scheme
from platform_ctrl.export.code.wording import block, signature

_END_OF_NAMES = ["#ifdef __cplusplus", "}", "#endif", ""]


def header_file(prefix: str, head: Iterable[str], includes: Sequence[str], body: Iterable[str]) -> str:
    """Return the text of a header that may be included twice, and by C++; `includes` as they stand behind #include."""
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


def measured(schemes: Sequence[Scheme]) -> dict[str, int]:
    """Return the signals that no controller before gives, each with the number of the first that takes it in."""
    made: set[str] = set()
    out: dict[str, int] = {}
    for k, scheme in enumerate(schemes):
        for name in scheme.inputs:
            if name not in made:
                out.setdefault(name, k)
        made |= set(scheme.outputs)
    return out
