"""Every public name says what it is, its shapes and units, what it raises and where it comes from (numpydoc style)."""

from __future__ import annotations

import ast
import dataclasses
import doctest
import functools
import inspect
import logging
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import griffe
import pytest
from numpydoc.docscrape import NumpyDocString, Parameter

from platform_ctrl import errors
from public_modules import described, methods, public

ROOT = Path(__file__).resolve().parent.parent

# How a source is written; nothing else may stand under References, so that one source has one name everywhere.
SOURCES = (
    "A. B. Owen, Journal of Complexity 14, 1998",
    "A. J. Laub, IEEE Trans. Automatic Control 24, 1979",
    "A. L. Tits, Y. Yang, IEEE Trans. Automatic Control 41, 1996",
    "A. Packard, J. C. Doyle, Automatica 29, 1993",
    "B. Bamieh, J. B. Pearson, IEEE Trans. Automatic Control 37, 1992",
    "B. Bamieh, J. B. Pearson, Systems & Control Letters 18, 1992",
    "C. J. Clopper, E. S. Pearson, Biometrika 26, 1934",
    "C. Scherer, P. Gahinet, M. Chilali, IEEE Trans. Automatic Control 42, 1997",
    "D. L. Kleinman, IEEE Trans. Automatic Control 13, 1968",
    "I. M. Sobol, Mathematics and Computers in Simulation 55, 2001",
    "I. M. Sobol, USSR Computational Mathematics and Mathematical Physics 7, 1967",
    "I. Papaioannou, W. Betz, K. Zwirglmaier, D. Straub, Probabilistic Engineering Mechanics 41, 2015",
    "J. Demmel et al., ACM Transactions on Mathematical Software 32, 2006",
    "J. H. Wilkinson, The Algebraic Eigenvalue Problem, 1965",
    "J. K. Salmon et al., SC 2011",
    "J. M. Gomes da Silva, S. Tarbouriech, IEEE Trans. Automatic Control 50, 2005",
    "J. V. Burke, D. Henrion, A. S. Lewis, M. L. Overton, IFAC ROCOND 2006",
    "K. Glover, J. C. Doyle, Systems & Control Letters 11, 1988",
    "K. J. Åström, B. Wittenmark, Computer-Controlled Systems, 1997",
    "K. J. Åström, R. M. Murray, Feedback Systems, 2008",
    "K. Magnus, Ingenieur-Archiv 1976",
    "K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control, 1996",
    "M. C. de Oliveira, J. C. Geromel, J. Bernussou, Int. J. Control 75, 2002",
    "M. Chilali, P. Gahinet, IEEE Trans. Automatic Control 41, 1996",
    "M. D. McKay, R. J. Beckman, W. J. Conover, Technometrics 21, 1979",
    "M. Shinozuka, Journal of the Acoustical Society of America 49, 1971",
    "Modelica Association, Functional Mock-up Interface Specification 3.0, 2022",
    "N. A. Bruinsma, M. Steinbuch, Systems & Control Letters 14, 1990",
    "P. Apkarian, D. Noll, IEEE Trans. Automatic Control 51, 2006",
    "P. Apkarian, P. Gahinet, G. Becker, Automatica 31, 1995",
    "P. Gahinet, Automatica 32, 1996",
    "P. Gahinet, P. Apkarian, Int. J. Robust and Nonlinear Control 4, 1994",
    "P. Seiler, A. Packard, P. Gahinet, IEEE Control Systems Magazine 40(5), 2020",
    "P. T. Kabamba, S. Hara, IEEE Trans. Automatic Control 38, 1993",
    "R. Featherstone, Rigid Body Dynamics Algorithms, 2008",
    "R. Y. Rubinstein, D. P. Kroese, The Cross-Entropy Method, 2004",
    "R. A. Fisher, Journal of the Royal Statistical Society 85, 1922",
    "S. Boyd, L. El Ghaoui, E. Feron, V. Balakrishnan, Linear Matrix Inequalities in System and Control Theory, 1994",
    "S. Boyd, M. Hast, K. J. Åström, Int. J. Robust and Nonlinear Control 26, 2016",
    "S. Boyd, V. Balakrishnan, Systems & Control Letters 15, 1990",
    "S. Holm, Scandinavian Journal of Statistics 6, 1979",
    "S. K. Au, J. L. Beck, Probabilistic Engineering Mechanics 16, 2001",
    "S. Skogestad, I. Postlethwaite, Multivariable Feedback Control, 2005",
    "T. Chen, B. A. Francis, Optimal Sampled-Data Control Systems, 1995",
    "T. L. Kelley, Proceedings of the National Academy of Sciences 21, 1935",
    "U. Olsson, Journal of Statistics Education 13, 2005",
    "W. Campbell, Trans. ASME 46, 1924",
    "W. H. Kruskal, W. A. Wallis, Journal of the American Statistical Association 47, 1952",
    "W. R. Evans, Trans. AIEE 67, 1948",
    "See docs/",  # the page that derives it, beside a source of the literature
)

NUMBERS = re.compile(r"\b(ArrayLike|FloatArray|ComplexArray|float|complex)\b")
ARRAYS = re.compile(r"\b(ArrayLike|FloatArray|ComplexArray)\b")
SHAPE = re.compile(r"\([^()]*,[^()]*\)|\(\.\.\.\)|scalar|any shape|[Aa]s (in|of) `|[Aa]s `")
UNIT = re.compile(
    r"(?<![\w'’])(rad|rad/s²?|kg m²|kg m|N m|Hz|m/s²|s|1/s|SI|[Rr]elative|[Dd]imensionless|[Uu]nits?|"
    r"[Rr]atios?|[Ff]actors?|[Ss]hares?|[Pp]robability|[Pp]robabilities|booleans)(?!\w)|[Aa]s (in|of) `|[Aa]s `"
)


@functools.cache
def functions() -> dict[str, Callable[..., Any]]:
    """Return the public functions and methods by name; what overrides a method is described where that is."""
    found = {name: item for name, item in described().items() if not inspect.isclass(item)}
    for name, item in classes().items():
        inherited = {m for base in item.__mro__[1:-1] for m in vars(base)}
        own = {m: f for m, f in methods(item) if not isinstance(f, property) and m not in inherited}
        if name not in public():  # methods that are for the package alone are described in a line
            own = {m: f for m, f in own.items() if parsed(f)["Parameters"]}
        found |= {f"{name}.{m}": f for m, f in own.items()}
    return found


def classes() -> dict[str, type]:
    """Return the public classes by name."""
    return {name: item for name, item in described().items() if inspect.isclass(item)}


def parsed(item: object) -> NumpyDocString:
    """Return the docstring as numpydoc reads it, whose warnings are errors here."""
    return NumpyDocString(inspect.cleandoc(item.__doc__ or ""))


def entries(section: Sequence[Parameter]) -> dict[str, str]:
    """Return what a section says about each name: its type and text, by the name."""
    return {
        name.strip().lstrip("*"): f"{entry.type} {' '.join(entry.desc)}"
        for entry in section
        for name in entry.name.split(",")
    }


def judge_summary(doc: NumpyDocString) -> None:
    summary = " ".join(doc["Summary"])
    assert summary.endswith((".", ":")), f"summary: {summary!r}"


def judge_numbers(said: Mapping[str, str], annotations: Mapping[str, object]) -> None:
    """Arrays have a shape and a unit, numbers a unit."""
    for name, text in said.items():
        annotation = str(annotations.get(name, ""))
        if ARRAYS.search(annotation):
            assert SHAPE.search(text), f"{name}: no shape in {text!r}"
        if NUMBERS.search(annotation):
            assert UNIT.search(text), f"{name}: no unit in {text!r}"


def kinds(doc: NumpyDocString) -> tuple[type[Exception], ...]:
    """Return the errors that a docstring names: of the one tree, and those by which a test fails."""
    named = [kind for entry in doc["Raises"] for kind in entry.type.split(", ")]
    return tuple(AssertionError if kind == "AssertionError" else getattr(errors, kind) for kind in named)


def raised_itself(item: Callable[..., Any]) -> set[str]:
    """Return the errors of the one tree that a function's own lines raise."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(item)))
    named = [node.exc.func for node in ast.walk(tree) if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call)]
    return {name.id for name in named if isinstance(name, ast.Name) and hasattr(errors, name.id)}


@pytest.mark.parametrize("name", functions())
def test_functions_say_what_they_take_and_return(name: str) -> None:
    item = functions()[name]
    doc, signature = parsed(item), inspect.signature(item)
    judge_summary(doc)
    taken = {n: p.annotation for n, p in signature.parameters.items() if n not in ("self", "cls")}
    said = entries(doc["Parameters"])
    assert list(said) == list(taken), "Parameters are not those of the signature"
    judge_numbers(said, taken)
    for parameter, text in said.items():
        assert text.strip(), f"{parameter}: nothing said"
    given = doc["Returns"] + doc["Yields"]
    assert bool(given) == (signature.return_annotation not in ("None", None)), "Returns"
    text = " ".join(f"{entry.name} {entry.type} {' '.join(entry.desc)}" for entry in given)
    judge_numbers({"return": text}, {"return": signature.return_annotation})


@pytest.mark.parametrize("name", functions())
def test_functions_say_what_they_raise(name: str) -> None:
    item = functions()[name]
    doc = parsed(item)
    named = kinds(doc)
    tree = (errors.PlatformCtrlError, AssertionError) if ".testing." in name else errors.PlatformCtrlError
    assert all(issubclass(kind, tree) for kind in named)
    for kind in raised_itself(item):
        assert issubclass(getattr(errors, kind), named), f"{kind} is raised and not named"


@pytest.mark.parametrize("name", classes())
def test_classes_say_what_they_hold(name: str) -> None:
    item = classes()[name]
    doc = parsed(item)
    judge_summary(doc)
    if dataclasses.is_dataclass(item):
        fields = {field.name: field.type for field in dataclasses.fields(item)}
    else:
        fields = {field: item.__annotations__[field] for field in getattr(item, "_fields", ())}
    fields = {field: kind for field, kind in fields.items() if field[0] != "_"}
    said = entries(doc["Attributes"])
    if fields:
        assert sorted(said) == sorted(fields), "Attributes are not the fields"
    judge_numbers(said, fields)
    for attribute, text in said.items():
        assert text.strip(), f"{attribute}: nothing said"
    for method, member in methods(item):
        judge_summary(parsed(member))
        if isinstance(member, property) and member.fget is not None:
            judge_summary(parsed(member))
            annotation = inspect.signature(member.fget).return_annotation
            judge_numbers({method: inspect.getdoc(member) or ""}, {method: annotation})


SOURCED = {name: item for name, item in described().items() if parsed(item)["References"]}


@pytest.mark.parametrize("name", SOURCED)
def test_a_source_is_written_as_everywhere(name: str) -> None:
    for source in ("\n".join(parsed(SOURCED[name])["References"])).split("\n\n"):
        source = " ".join(source.split())
        assert source.startswith(SOURCES), f"source: {source!r}"
        assert source.endswith("."), f"source: {source!r}"
        for page in re.findall(r"docs/\S+\.md", source):
            assert (ROOT / page).is_file(), page


def test_the_reference_pages_generator_reads_every_docstring_without_a_warning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    package = griffe.load("platform_ctrl", docstring_parser="numpy", resolve_aliases=False)
    with caplog.at_level(logging.WARNING):
        for item in described().values():
            found = package[f"{item.__module__}.{item.__qualname__}".removeprefix("platform_ctrl.")]
            members = [member for name, member in found.members.items() if name[0] != "_"] if found.is_class else []
            for one in (found, *members):
                if one.docstring is not None:
                    one.docstring.parse("numpy")
    assert [record.getMessage() for record in caplog.records] == []


EXAMPLES = {name: item for name, item in described().items() if parsed(item)["Examples"]}


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_print_what_they_say(name: str) -> None:
    source = inspect.getdoc(EXAMPLES[name]) or ""
    example = doctest.DocTestParser().get_doctest(source, {}, name, None, None)
    assert doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(example).failed == 0
