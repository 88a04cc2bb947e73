"""What the shell offers when Tab is pressed: plants, jobs, their manoeuvres, folders. Quick, and silent on errors.

Nothing of the package is loaded here: files are recognised by their tables, not read as plants or jobs. Where nothing
fits, the shell offers files as it does everywhere.
"""

from __future__ import annotations

import os
import re
import shlex
import tomllib
from collections.abc import Callable, Iterator, Sequence
from functools import wraps
from importlib import resources
from pathlib import Path

import typer

Offer = str | tuple[str, str]
Completer = Callable[[typer.Context, str], list[Offer]]

# A plant has a root, a job has loops; either is a table or a key.
_PLANT = re.compile(rb"^[ \t]*(\[[ \t]*root[ \t]*\]|root[ \t]*=)", re.MULTILINE)
_JOB = re.compile(rb"^[ \t]*(\[\[[ \t]*loop[ \t]*\]\]|loop[ \t]*=)", re.MULTILINE)
# Files that are looked into, and bytes of each: Tab answers at once in whatever folder.
_FILES, _BYTES = 200, 1 << 18
_PLAIN = re.compile(r"[\w./+@%,-]*")


class _Fitting(str):
    """A word that matches: typer would compare quoted words with unquoted ones."""

    __slots__ = ()

    def startswith(self, *given: object) -> bool:
        return True


def _silent(found: Callable[[typer.Context, str], Iterator[Offer]]) -> Completer:
    """Return a completer that offers what `found` gives and begins with the word, and nothing if it fails."""

    @wraps(found)
    def completer(ctx: typer.Context, incomplete: str) -> list[Offer]:
        try:
            offers = [(one, "") if isinstance(one, str) else one for one in found(ctx, incomplete)]
        except Exception:
            return []
        fitting = [(word, words) for word, words in offers if word.startswith(incomplete)]
        return [(_Fitting(_quoted(word)), words) if words else _Fitting(_quoted(word)) for word, words in fitting]

    return completer


@_silent
def plants(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
    """Offer the shipped plants and plant files."""
    yield from _shipped()
    yield from _files(incomplete, ".toml", _PLANT)


@_silent
def jobs(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
    """Offer job files."""
    yield from _files(incomplete, ".toml", _JOB)


@_silent
def jobs_and_plants(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
    """Offer job files, plant files and the shipped plants."""
    yield from _files(incomplete, ".toml", _JOB)
    yield from _shipped()
    yield from _files(incomplete, ".toml", _PLANT)


@_silent
def manoeuvres(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
    """Offer the manoeuvres of the job earlier on the line."""
    # An option that still lacks its value leaves the arguments before it unread.
    path = ctx.params.get("job") or ctx.args[0]
    with open(os.path.expanduser(path), "rb") as file:
        job = tomllib.load(file)
    for manoeuvre in job["manoeuvre"]:
        yield manoeuvre["name"], f"{manoeuvre['mode']}, {manoeuvre['duration']} s"


@_silent
def controller_files(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
    """Offer JSON files that hold controllers."""
    yield from _files(incomplete, ".json", re.compile(rb'"controllers"\s*:'))


@_silent
def campaign_folders(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
    """Offer folders that hold a campaign."""
    for folder in _folders(incomplete):
        if (Path(folder) / "campaign.json").is_file():
            yield folder


def words(*known: str) -> Completer:
    """Return a completer that offers these words."""

    @_silent
    def completer(ctx: typer.Context, incomplete: str) -> Iterator[Offer]:
        yield from known

    return completer


def _shipped() -> Sequence[str]:
    try:
        folder = resources.files("platform_ctrl.models")
    except ModuleNotFoundError:
        folder = Path(__file__).parents[2] / "models"  # a plain checkout on the path
    return sorted(file.name.removesuffix(".toml") for file in folder.iterdir() if file.name.endswith(".toml"))


def _files(incomplete: str, suffix: str, kind: re.Pattern[bytes]) -> Iterator[str]:
    """Go through the files of a kind that the word can become, in its folder and one below.

    Folders themselves are not offered: shells put a space behind what is, and the rest could not be typed on.
    """
    folder_part, prefix = os.path.split(incomplete)
    start = os.path.join(folder_part, "") if folder_part else ""
    below = [os.path.join(folder, "") for folder in _folders(incomplete)]
    looked = 0
    for folder, first in ((start, prefix), *((one, "") for one in below)):
        for name in _listed(folder):
            if not (name.startswith(first) and name.endswith(suffix)) or _hidden(name, first):
                continue
            looked += 1
            if looked > _FILES:
                return
            with open(os.path.expanduser(folder + name), "rb") as file:
                if kind.search(file.read(_BYTES)):
                    yield folder + name


def _folders(incomplete: str) -> list[str]:
    folder_part, prefix = os.path.split(incomplete)
    start = os.path.join(folder_part, "") if folder_part else ""
    names = [name for name in _listed(start) if name.startswith(prefix) and not _hidden(name, prefix)]
    return [start + name for name in names if os.path.isdir(os.path.expanduser(start + name))]


def _listed(folder: str) -> list[str]:
    try:
        return sorted(os.listdir(os.path.expanduser(folder) or "."))
    except OSError:
        return []


def _hidden(name: str, first: str) -> bool:
    return name.startswith(".") and not first.startswith(".")


def _quoted(word: str) -> str:
    """Return a word quoted for the line; zsh and fish quote it themselves."""
    if _PLAIN.fullmatch(word) or word.startswith("~"):
        return word
    shell = os.environ.get("_PLATFORM_CTRL_COMPLETE", "").rpartition("_")[2]
    if shell == "bash":
        return re.sub(r"([^\w./+@%,:=-])", r"\\\1", word)
    if shell in ("powershell", "pwsh"):
        return shlex.quote(word) if "'" not in word else '"' + word + '"'
    return word
