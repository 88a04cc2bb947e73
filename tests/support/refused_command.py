"""Commands with wrong input, for the tests of the command line."""

from __future__ import annotations

import pytest

from platform_ctrl.cli import main


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run wrong input; return the one line that says so."""
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("platform-ctrl: error: ")
    assert len(err.splitlines()) == 1
    return err
