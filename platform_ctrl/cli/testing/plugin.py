"""The pytest plugin. Pytest loads it into every run: it imports the library when a test uses a job, not before."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from platform_ctrl.cli.testing.session import BaselineTest, JobFile, JobSession, JobUnderTest, RequirementTest
    from platform_ctrl.verification import JobResult
    from platform_ctrl.verification.baselines.comparison import Comparison
    from platform_ctrl.verification.baselines.file import Update

_MARKER = "platform_job"
_NOTES = "platform_ctrl_notes"
_SESSION: pytest.StashKey[JobSession] = pytest.StashKey()
_FROM_WORKERS: pytest.StashKey[list[str]] = pytest.StashKey()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("platform_ctrl", "control loops of gimballed platforms (platform_ctrl)")
    group.addoption(
        "--update-baselines",
        action="store_true",
        help="Accept the present values of every job with a baseline: write the baselines.",
    )
    group.addoption(
        "--platform-jobs",
        action="append",
        metavar="GLOB",
        default=[],
        help="Collect matching job files (TOML) as tests, an item for every requirement; may be repeated. A job file "
        "that is named on the command line is always collected.",
    )
    group.addoption(
        "--platform-plots",
        metavar="DIR",
        help="Folder for plots of changes since a baseline. Default: beside the baseline.",
    )
    parser.addini("platform_jobs", "Job files (TOML) that are collected as tests, as glob patterns.", "args", [])


def pytest_configure(config: pytest.Config) -> None:
    """Tell pytest of the marker."""
    config.addinivalue_line(
        "markers",
        f"{_MARKER}(job, controllers=None, baseline=None): run the test once for every requirement of a job file, "
        "as the argument `requirement`; and, with a baseline, once for that. Relative paths start at the test's file.",
    )


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> JobFile | None:
    """Collect the selected job files."""
    if file_path.suffix != ".toml" or not _selected(file_path, parent):
        return None
    from platform_ctrl.cli.testing.session import JobFile

    found: JobFile = JobFile.from_parent(parent, path=file_path)
    found.jobs = _session(parent.config)
    return found


def _selected(path: Path, parent: pytest.Collector) -> bool:
    if parent.session.isinitpath(path):
        return True
    patterns = [*parent.config.getini("platform_jobs"), *parent.config.getoption("--platform-jobs")]
    if not patterns or path.name == "pyproject.toml":
        return False
    root = parent.config.rootpath
    place = PurePosixPath((path.relative_to(root) if path.is_relative_to(root) else path).as_posix())
    return any(place.match(pattern) for pattern in patterns)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run a marked test once for every requirement of its job."""
    marker = metafunc.definition.get_closest_marker(_MARKER)
    if marker is None:
        return
    if "requirement" in metafunc.fixturenames:
        tests = _job(marker, metafunc.config, metafunc.definition).tests()
        metafunc.parametrize("requirement", tests, ids=[test.id for test in tests], indirect=True)
    elif "job_result" not in metafunc.fixturenames:
        pytest.fail(
            f"{metafunc.definition.nodeid}: marked {_MARKER}, but takes neither `requirement` nor `job_result`",
            pytrace=False,
        )


@pytest.fixture(scope="session")
def closed_loop(pytestconfig: pytest.Config) -> Callable[..., JobResult]:
    """Close the loops of a job: ``result = closed_loop("gyros.toml")``.

    Called with a job (path, dict, or Job) and, if they exist already, its `controllers` (path of a result.json or of a
    baseline, or control.StateSpace): without them every loop is designed. Returns a JobResult, measured and proved as
    by ``platform-ctrl check``. Relative paths start at the folder of the file that calls. The same job with the same
    controllers is worked out once in a session.
    """

    def closed(job: Any, controllers: Any = None) -> JobResult:
        __tracebackhide__ = True
        return _session(pytestconfig).closed(job, controllers, _folder_of_caller())

    return closed


@pytest.fixture(scope="session")
def assert_baseline(pytestconfig: pytest.Config) -> Callable[..., Comparison | Update]:
    """Assert that no figure of a job became worse: ``assert_baseline(closed_loop("gyros.toml"), "gyros.json")``.

    Called with a JobResult and the file of the accepted figures. With ``--update-baselines`` writes the file and
    asserts nothing. A relative path starts at the folder of the file that calls.
    """

    def asserted(result: JobResult, file: str | Path) -> Comparison | Update:
        __tracebackhide__ = True
        from platform_ctrl.cli.testing.assertions import baseline_path

        return _session(pytestconfig).compare(result, _folder_of_caller() / baseline_path(file))

    return asserted


@pytest.fixture
def requirement(request: pytest.FixtureRequest) -> RequirementTest | BaselineTest:
    """One requirement of the job of the marker ``platform_job``: ``requirement.assert_met()``."""
    if not hasattr(request, "param"):
        pytest.fail(f"the fixture `requirement` needs the marker {_MARKER}(job)", pytrace=False)
    test: RequirementTest | BaselineTest = request.param
    test.record = lambda name, item: request.node.user_properties.append((name, item))
    return test


@pytest.fixture
def job_result(request: pytest.FixtureRequest) -> JobResult:
    """The JobResult of the job of the marker ``platform_job``."""
    marker = request.node.get_closest_marker(_MARKER)
    if marker is None:
        pytest.fail(f"the fixture `job_result` needs the marker {_MARKER}(job)", pytrace=False)
    return _job(marker, request.config, request.node).result


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Hand over the notes of a worker process."""
    output = getattr(session.config, "workeroutput", None)
    if output is not None and _SESSION in session.config.stash:
        output[_NOTES] = session.config.stash[_SESSION].notes


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Take the notes of a worker process."""
    notes = getattr(node, "workeroutput", {}).get(_NOTES, [])
    node.config.stash.setdefault(_FROM_WORKERS, []).extend(notes)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """List the baselines that were written or could be."""
    notes = [*config.stash.setdefault(_FROM_WORKERS, [])]
    if _SESSION in config.stash:
        notes += config.stash[_SESSION].notes
    if notes:
        terminalreporter.section("baselines")
        for line in sorted(set(notes)):
            terminalreporter.write_line(line)


def _session(config: pytest.Config) -> JobSession:
    if _SESSION not in config.stash:
        from platform_ctrl.cli.testing.session import JobSession

        plots = config.getoption("--platform-plots")
        folder = None if plots is None else config.invocation_params.dir / plots
        config.stash[_SESSION] = JobSession(bool(config.getoption("--update-baselines")), folder)
    return config.stash[_SESSION]


def _job(marker: pytest.Mark, config: pytest.Config, node: Any) -> JobUnderTest:
    """Return the job that a marker names."""
    from platform_ctrl.cli.testing.session import JobUnderTest
    from platform_ctrl.errors import PlatformCtrlError

    try:
        options = inspect.signature(lambda job, controllers=None, baseline=None: None).bind(
            *marker.args, **marker.kwargs
        )
    except TypeError as error:
        pytest.fail(
            f"{node.nodeid}: {_MARKER}: {error}; the arguments are (job, controllers=, baseline=)", pytrace=False
        )
    given = {"controllers": None, "baseline": None} | options.arguments
    folder = node.path.parent
    from platform_ctrl.cli.testing.assertions import baseline_path

    try:
        file = None if given["baseline"] is None else folder / baseline_path(given["baseline"])
        return JobUnderTest(_session(config), given["job"], given["controllers"], folder, file)
    except PlatformCtrlError as error:
        pytest.fail(f"{node.nodeid}: {error}", pytrace=False)


def _folder_of_caller() -> Path:
    """Return the folder of the file in which a fixture's function is called."""
    frame = inspect.currentframe()
    caller = frame.f_back.f_back if frame is not None and frame.f_back is not None else None
    file = None if caller is None else caller.f_globals.get("__file__")
    return Path(file).parent if file else Path()
