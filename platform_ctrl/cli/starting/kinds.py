"""What ``platform-ctrl new --kind`` starts from."""

from __future__ import annotations

from typing import NamedTuple


class Kind(NamedTuple):  # completion reads it: nothing heavy may be loaded for it
    """A kind of device to start from."""

    words: str  # What it is
    plant: str | None  # The shipped plant that is taken; None: the one of `files.own_start`


KINDS: dict[str, Kind] = {
    "caged-gyro": Kind(words="one gyro in two gimbals", plant=None),
    "camera-gimbal": Kind(words="two axes, gyros on the camera", plant="camera_gimbal"),
    "multirotor-gimbal": Kind(words="three axes, gyros on the camera", plant="multirotor_gimbal"),
    "seeker-head": Kind(words="optics in two gimbals, gyros on the inner one", plant="seeker_head"),
    "steering-mirror": Kind(words="tip and tilt on flexures", plant="fast_steering_mirror"),
    "floated-gyro": Kind(words="one axis held by a rate-integrating gyro", plant="floated_gyro_platform"),
    "stabilised-platform": Kind(words="a free platform with three caged gyros", plant="three_gyro_platform"),
    "control-moment-gyro": Kind(words="four gimballed rotors that turn a satellite", plant="vscmg_pyramid"),
}
# What new starts from where nothing is said.
DEFAULT = "caged-gyro"


def known_kinds() -> str:
    """Return the kinds as a message lists them."""
    return ", ".join(KINDS)
