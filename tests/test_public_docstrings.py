"""Every public name says what it is, its shapes and units, what it raises and where it comes from (numpydoc style)."""

from __future__ import annotations

import dataclasses
import functools
import importlib
import inspect
import logging
import re
import sys
from collections.abc import Iterator

import griffe
import pytest
from numpydoc.docscrape import NumpyDocString

from platform_ctrl import errors

# The modules that users import from; a module without `__all__` is public with all that it defines.
MODULES = (
    "platform_ctrl",
    *(
        f"platform_ctrl.{module}"
        for module in (
            "analysis",
            "campaign",
            "certificates",
            "check",
            "description",
            "design",
            "design.measured",
            "errors",
            "force_elements",
            "job",
            "linearisation",
            "mechanics",
            "parameter_varying",
            "parameters",
            "precession",
            "reading",
            "requirements",
            "scenario",
            "simulation",
            "state_space",
            "symbolic",
            "terms",
            "variation",
        )
    ),
)

# How a source is written; nothing else may stand under References, so that one source has one name everywhere.
SOURCES = (
    "A. J. Laub, IEEE Trans. Automatic Control 24, 1979",
    "A. L. Tits, Y. Yang, IEEE Trans. Automatic Control 41, 1996",
    "A. Packard, J. C. Doyle, Automatica 29, 1993",
    "B. Bamieh, J. B. Pearson, IEEE Trans. Automatic Control 37, 1992",
    "B. Bamieh, J. B. Pearson, Systems & Control Letters 18, 1992",
    "C. Scherer, P. Gahinet, M. Chilali, IEEE Trans. Automatic Control 42, 1997",
    "J. Demmel et al., ACM Transactions on Mathematical Software 32, 2006",
    "J. H. Wilkinson, The Algebraic Eigenvalue Problem, 1965",
    "J. M. Gomes da Silva, S. Tarbouriech, IEEE Trans. Automatic Control 50, 2005",
    "J. V. Burke, D. Henrion, A. S. Lewis, M. L. Overton, IFAC ROCOND 2006",
    "K. Glover, J. C. Doyle, Systems & Control Letters 11, 1988",
    "K. J. Åström, B. Wittenmark, Computer-Controlled Systems, 1997",
    "K. J. Åström, R. M. Murray, Feedback Systems, 2008",
    "K. Magnus, Ingenieur-Archiv 1976",
    "K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control, 1996",
    "M. C. de Oliveira, J. C. Geromel, J. Bernussou, Int. J. Control 75, 2002",
    "M. Chilali, P. Gahinet, IEEE Trans. Automatic Control 41, 1996",
    "M. Shinozuka, Journal of the Acoustical Society of America 49, 1971",
    "N. A. Bruinsma, M. Steinbuch, Systems & Control Letters 14, 1990",
    "P. Apkarian, D. Noll, IEEE Trans. Automatic Control 51, 2006",
    "P. Apkarian, P. Gahinet, G. Becker, Automatica 31, 1995",
    "P. Gahinet, Automatica 32, 1996",
    "P. Gahinet, P. Apkarian, Int. J. Robust and Nonlinear Control 4, 1994",
    "P. Seiler, A. Packard, P. Gahinet, IEEE Control Systems Magazine 40(5), 2020",
    "P. T. Kabamba, S. Hara, IEEE Trans. Automatic Control 38, 1993",
    "R. Featherstone, Rigid Body Dynamics Algorithms, 2008",
    "S. Boyd, L. El Ghaoui, E. Feron, V. Balakrishnan, Linear Matrix Inequalities in System and Control Theory, 1994",
    "S. Boyd, M. Hast, K. J. Åström, Int. J. Robust and Nonlinear Control 26, 2016",
    "S. Boyd, V. Balakrishnan, Systems & Control Letters 15, 1990",
    "S. Skogestad, I. Postlethwaite, Multivariable Feedback Control, 2005",
    "T. Chen, B. A. Francis, Optimal Sampled-Data Control Systems, 1995",
    # Not from the literature.
    "See docs/",  # the page that derives it, or says what the format is
    "As `",  # the public name that computes it
    "Own definition",
    "Textbook definition",
)

# What a function says that raises nothing of its own: what is wrong with its arguments shows where it may.
UNJUDGED = "The arguments are not judged"

NUMBERS = re.compile(r"\b(ArrayLike|FloatArray|ComplexArray|float|complex)\b")
ARRAYS = re.compile(r"\b(ArrayLike|FloatArray|ComplexArray)\b")
SHAPE = re.compile(r"\([^()]*,[^()]*\)|\(\.\.\.\)|scalar|any shape|[Ss]hape of|[Aa]s in `|[Aa]s `")
UNIT = re.compile(
    r"(?<![\w'’])(rad|rad/s²?|kg m²|kg m|N m|Hz|m/s²|m²/s³|s|1/s|dB|SI|[Rr]elative|[Dd]imensionless|[Uu]nits?|"
    r"[Rr]atios?|[Ff]actors?|[Ss]hares?|[Pp]robability|[Pp]robabilities|booleans)(?!\w)|[Aa]s in `|[Aa]s `"
)


@functools.cache
def public() -> dict[str, object]:
    """Return the objects that the public names stand for, each once, by module and name."""
    found: dict[str, object] = {}
    known = set()
    for name in MODULES:
        importlib.import_module(name)
        module = sys.modules[name]
        own = [n for n, o in vars(module).items() if n[0] != "_" and getattr(o, "__module__", None) == name]
        for public_name in getattr(module, "__all__", own):
            item = getattr(module, public_name)
            documented = inspect.isclass(item) or inspect.isroutine(item)
            if documented and id(item) not in known and ".report" not in item.__module__:
                known.add(id(item))
                found[f"{name}.{public_name}"] = item
    return found


def methods(cls: type) -> Iterator[tuple[str, object]]:
    """Yield the public functions and properties that a class itself defines."""
    for name, item in vars(cls).items():
        if name[0] != "_":
            if isinstance(item, classmethod | staticmethod):
                yield name, item.__func__
            elif inspect.isfunction(item) or isinstance(item, property):
                yield name, item


@functools.cache
def functions() -> dict[str, object]:
    """Return the public functions and methods by name."""
    found = {name: item for name, item in public().items() if not inspect.isclass(item)}
    for name, item in public().items():
        if inspect.isclass(item):
            found |= {f"{name}.{m}": f for m, f in methods(item) if not isinstance(f, property)}
    return found


def classes() -> dict[str, type]:
    """Return the public classes by name."""
    return {name: item for name, item in public().items() if inspect.isclass(item)}


def parsed(item: object) -> NumpyDocString:
    """Return the docstring as numpydoc reads it, whose warnings are errors here."""
    return NumpyDocString(inspect.cleandoc(item.__doc__ or ""))


def entries(section: list) -> dict[str, str]:
    """Return what a section says about each name: its type and text, by the name."""
    return {
        name.strip().lstrip("*"): f"{entry.type} {' '.join(entry.desc)}"
        for entry in section
        for name in entry.name.split(",")
    }


def judged_summary(doc: NumpyDocString) -> None:
    summary = " ".join(doc["Summary"])
    assert summary.endswith((".", ":")), f"summary: {summary!r}"


def judged_numbers(said: dict[str, str], annotations: dict[str, object]) -> None:
    """Arrays have a shape and a unit, numbers a unit."""
    for name, text in said.items():
        annotation = str(annotations.get(name, ""))
        if ARRAYS.search(annotation):
            assert SHAPE.search(text), f"{name}: no shape in {text!r}"
        if NUMBERS.search(annotation):
            assert UNIT.search(text), f"{name}: no unit in {text!r}"


def judged_sources(doc: NumpyDocString) -> None:
    paragraphs = [" ".join(part.split()) for part in "\n".join(doc["References"]).split("\n\n")]
    assert any(paragraphs), "no source under References"
    for source in paragraphs:
        assert source.startswith(SOURCES), f"source: {source!r}"
        assert source.endswith("."), f"source: {source!r}"


@pytest.mark.parametrize("name", functions())
def test_functions_say_what_they_take_return_and_raise(name: str) -> None:
    item = functions()[name]
    doc, signature = parsed(item), inspect.signature(item)
    judged_summary(doc)
    taken = {n: p.annotation for n, p in signature.parameters.items() if n not in ("self", "cls")}
    said = entries(doc["Parameters"])
    assert list(said) == list(taken), "Parameters are not those of the signature"
    judged_numbers(said, taken)
    for parameter, text in said.items():
        assert text.strip(), f"{parameter}: nothing said"
    given = doc["Returns"] + doc["Yields"]
    assert bool(given) == (signature.return_annotation not in ("None", None)), "Returns"
    judged_numbers({"return": " ".join(entries_of_returns(given))}, {"return": signature.return_annotation})
    raised = [kind for entry in doc["Raises"] for kind in entry.type.split(", ")]
    for kind in raised:
        assert issubclass(getattr(errors, kind), errors.PlatformCtrlError)
    if taken and not raised:
        assert UNJUDGED in " ".join(doc["Notes"]), "neither Raises nor a note that arguments are not judged"


def entries_of_returns(section: list) -> list[str]:
    return [f"{entry.name} {entry.type} {' '.join(entry.desc)}" for entry in section]


@pytest.mark.parametrize("name", classes())
def test_classes_say_what_they_hold(name: str) -> None:
    item = classes()[name]
    doc = parsed(item)
    judged_summary(doc)
    fields = (
        {field.name: field.type for field in dataclasses.fields(item)}
        if dataclasses.is_dataclass(item)
        else dict.fromkeys(getattr(item, "_fields", ()), "")
    )
    fields = {n: t for n, t in fields.items() if n[0] != "_"}
    said = entries(doc["Attributes"])
    if fields:
        assert sorted(said) == sorted(fields), "Attributes are not the fields"
    judged_numbers(said, fields)
    for attribute, text in said.items():
        assert text.strip(), f"{attribute}: nothing said"
    for method, member in methods(item):
        if isinstance(member, property):
            text = inspect.cleandoc(member.__doc__ or "")
            judged_summary(parsed(member))
            annotation = str(inspect.signature(member.fget).return_annotation)
            judged_numbers({method: text}, {method: annotation})


@pytest.mark.parametrize("name", public())
def test_every_public_name_has_a_source(name: str) -> None:
    item = public()[name]
    if not (inspect.isclass(item) and issubclass(item, Exception)):
        judged_sources(parsed(item))


def test_the_reference_reads_every_docstring_without_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    package = griffe.load("platform_ctrl", docstring_parser="numpy", resolve_aliases=False)
    with caplog.at_level(logging.WARNING):
        for name, item in public().items():
            where = f"{item.__module__}.{item.__qualname__}".removeprefix("platform_ctrl.")
            found = package[where]
            read(found)
            for member in found.members.values() if found.is_class else ():
                if not member.name.startswith("_"):
                    read(member)
    assert [record.getMessage() for record in caplog.records] == []


def read(item: griffe.Object) -> None:
    if item.docstring is not None:
        item.docstring.parse("numpy")


def test_sources_that_point_elsewhere_lead_to_a_source() -> None:
    for name, item in public().items():
        for target in re.findall(r"^As `(\w+)`", "\n".join(parsed(item)["References"]), flags=re.MULTILINE):
            at = [other for other in public() if other.rpartition(".")[2] == target]
            assert at, f"{name}: As `{target}`"
            assert not all("As `" in "\n".join(parsed(public()[other])["References"]) for other in at), name
