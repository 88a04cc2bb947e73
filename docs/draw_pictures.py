"""Draw the axes of every shipped model into docs/pictures/; the same models give the same files, byte for byte."""

from __future__ import annotations

from pathlib import Path

from platform_ctrl import read_platform, shipped_models
from platform_ctrl.common.files import write_whole
from platform_ctrl.common.palette import PALETTE, declarations
from platform_ctrl.report import style
from platform_ctrl.report.figures.plant import axes_picture

PICTURES = Path(__file__).parent / "pictures"
RULES = (
    "<style>text{font-family:system-ui,-apple-system,Segoe UI,Roboto,DejaVu Sans,sans-serif}"
    f"svg:root{{background:var(--page);{declarations(PALETTE['light'])}}}"
    f"@media (prefers-color-scheme:dark){{svg:root{{{declarations(PALETTE['dark'])}}}}}</style>"
)

if __name__ == "__main__":
    PICTURES.mkdir(exist_ok=True)
    for model in shipped_models():
        platform = read_platform(model)
        with style.settings():
            drawn = style.svg(axes_picture(platform), f"Axes of {platform.name}")
        head, _, rest = drawn.partition(">")
        head = head.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"')
        write_whole(PICTURES / f"{model}.svg", f"{head}>{RULES}{rest}\n")
