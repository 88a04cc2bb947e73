"""Draw the axes of every shipped model into docs/pictures/; the same models give the same files, byte for byte."""

from __future__ import annotations

from pathlib import Path

from platform_ctrl import read_platform, shipped_models
from platform_ctrl.common.files import write_whole
from platform_ctrl.report.figures.axes_picture import axes_picture

PICTURES = Path(__file__).parent / "pictures"

if __name__ == "__main__":
    PICTURES.mkdir(exist_ok=True)
    for model in shipped_models():
        write_whole(PICTURES / f"{model}.svg", axes_picture(read_platform(model)))
