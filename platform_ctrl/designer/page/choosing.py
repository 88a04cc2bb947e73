"""What the lists and switches of a page change in its settings; each choice is judged."""

from __future__ import annotations

from typing import TYPE_CHECKING

from platform_ctrl.arguments import known_name, known_names, whole
from platform_ctrl.errors import InputError
from platform_ctrl.signatures import short

if TYPE_CHECKING:
    from platform_ctrl.designer.values import Settings
    from platform_ctrl.designer.workbench import Workbench

NAMES = ("mode", "loop", "design", "channel", "plant", "axis", "band", "overlays")


def chosen(workbench: Workbench, settings: Settings, name: str, given: object, plants: tuple[str, ...]) -> Settings:
    """Return the settings with something else chosen.

    Parameters
    ----------
    workbench
        Knows what there is.
    settings
        As they are.
    name
        What is chosen, one of `NAMES`.
    given
        What the page sent for it, of any type.
    plants
        Labels of the plants that may be shown.

    Returns
    -------
    Settings
        New ones.

    Raises
    ------
    InputError, ArgumentError
        There is no such choice.

    References
    ----------
    See docs/designer.md.
    """
    offer = workbench.offer()
    known_name("choice", name, NAMES)
    if name == "axis":
        return settings.but(axis=whole("axis", given, 1, 3))
    if name == "band":
        if not isinstance(given, bool):
            raise InputError(f"band: given {short(given)}; expected true or false")
        return settings.but(band=given)
    if name == "overlays":
        others = [one for one in offer.designs[settings.loop] if one != settings.design]
        if not isinstance(given, list):
            raise InputError(f"overlays: given {short(given)}; expected a list of designs")
        return settings.but(overlays=tuple(others[k] for k in known_names("overlays", given, others)))
    text = _text(name, given)
    if name == "loop":
        return workbench.chosen(settings, loop=text)
    if name == "design":
        return workbench.chosen(settings, design=text)
    if name == "channel":
        known_name("channel", text, offer.channels[settings.loop])
        return settings.but(channel=text)
    if name == "plant":
        known_name("plant", text, plants)
        return settings.but(plant=text)
    if text == settings.mode:
        return settings
    for loop in offer.loops:
        other = workbench.chosen(settings, loop=loop)
        if other.mode == text:
            return other
    raise InputError(f"mode: given {short(given)}; expected one that this job has a loop for")


def _text(name: str, given: object) -> str:
    if not isinstance(given, str):
        raise InputError(f"{name}: given {short(given)}; expected a text")
    return given
