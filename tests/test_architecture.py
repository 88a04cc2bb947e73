"""The package as a whole: imports, import time, public names, the README's commands."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import grimp
import numpy as np
import pytest
from scipy.sparse import lil_array
from scipy.sparse.csgraph import connected_components

import platform_ctrl as pc

ROOT = Path(__file__).resolve().parent.parent
HEAVY = {"clarabel", "control", "cvxpy", "jinja2", "matplotlib", "numba", "rich", "scipy", "sympy", "typer"}


def python(code: str) -> str:
    """Run `code` in a fresh interpreter and return what it prints."""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_no_module_imports_itself_through_others() -> None:
    graph = grimp.build_graph("platform_ctrl")
    modules = sorted(graph.modules)
    links = lil_array((len(modules), len(modules)))
    for k, name in enumerate(modules):
        links[k, [modules.index(other) for other in graph.find_modules_directly_imported_by(name)]] = 1
    _, group = connected_components(links, connection="strong")
    together = [name for name, k in zip(modules, group, strict=True) if np.count_nonzero(group == k) > 1]
    assert together == []


def test_importing_the_package_loads_nothing_heavy_and_only_what_finds_its_names() -> None:
    loaded = set(json.loads(python("import sys, json, platform_ctrl; print(json.dumps(list(sys.modules)))")))
    assert not {name.partition(".")[0] for name in loaded} & HEAVY
    own = {name for name in loaded if name.partition(".")[0] == "platform_ctrl"}
    assert own == {"platform_ctrl", "platform_ctrl.common", "platform_ctrl.common.lazy"}


def test_what_compiles_draws_or_solves_and_what_is_optional_is_loaded_by_what_uses_it_alone() -> None:
    def loaded(*parts: str) -> str:
        return "".join(f"import platform_ctrl.{part}\n" for part in parts) + "print(json.dumps(list(sys.modules)))\n"

    page = loaded("app.session", "app.server", "app.backend")
    others = loaded("analysis", "simulation", "campaign.engine", "campaign.summary", "cli.commands")
    shown, whole = map(json.loads, python(f"import sys, json\n{page}{others}").splitlines())
    assert not set(shown) & {"numba", "cvxpy", "control", "sympy", "matplotlib"}
    assert not set(whole) & {"numba", "pyarrow", "pandas", "dask", "distributed", "matplotlib"}


def test_help_and_the_list_of_models_load_nothing_heavy() -> None:
    code = "import sys, json; from platform_ctrl.cli import main; main(['--help']); main(['models'])"
    loaded = json.loads(python(f"{code}; print(); print(json.dumps(list(sys.modules)))").splitlines()[-1])
    heavy = {"control", "cvxpy", "matplotlib", "numba", "scipy"}
    assert not {name.partition(".")[0] for name in loaded} & heavy


@pytest.mark.parametrize("name", pc.__all__)
def test_every_public_name_is_there_and_listed(name: str) -> None:
    assert getattr(pc, name) is not None
    assert name in dir(pc)


def test_the_readme_gives_two_commands_and_the_verdict_runs_the_second() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    commands = [line.strip() for line in readme.splitlines() if line.strip().startswith("python3 -m venv .venv && ")]
    assert len(commands) == 2
    assert "platform-ctrl design examples/three_gyro_platform.toml" in commands[0]
    assert commands[1].endswith("bin/pytest")
    assert commands[1] in (ROOT / ".ci" / "run").read_text(encoding="utf-8")


def test_the_table_of_where_to_look_names_files_that_exist() -> None:
    page = (ROOT / "docs" / "reference" / "architecture.md").read_text(encoding="utf-8")
    table = page.partition("| to find | look in |")[2].partition("\n\n")[0]
    named = set(re.findall(r"`([a-z0-9_]+/[\w/.]*)`", table))
    assert len(named) > 30
    assert [name for name in sorted(named) if not (ROOT / "platform_ctrl" / name).exists()] == []
