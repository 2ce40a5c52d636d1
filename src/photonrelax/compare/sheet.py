"""The contact sheet of a comparison, laid out as SJ13 Fig. 6: captions below, four in a row."""

from __future__ import annotations

from string import ascii_lowercase
from typing import TYPE_CHECKING

from .pictures import Bytes

if TYPE_CHECKING:
    from PIL.Image import Image as Picture
    from PIL.ImageDraw import ImageDraw

COLUMNS = 4
# Panels are shown this wide, whatever the size of the pictures.
_PANEL = 480
_GAP = 12
_CAPTION, _DETAIL = 20, 15
_BELOW = 60
_PAPER, _INK, _FAINT = (255, 255, 255), (20, 20, 20), (95, 95, 95)


def contact_sheet(panels: list[tuple[Bytes, str, str]], title: str) -> Picture:
    """Return panels of pictures (height, width, 3), captions and details below each.

    Parameters
    ----------
    panels : list of (picture, caption, detail)
        From left to right and top to bottom; all pictures of one size.
    title : str
        Below all of them.
    """
    from PIL import Image, ImageDraw

    height, width = panels[0][0].shape[:2]
    size = (_PANEL, max(round(_PANEL * height / width), 1))
    columns = min(COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    step = (size[0] + _GAP, size[1] + _BELOW)
    sheet = Image.new("RGB", (columns * step[0] + _GAP, rows * step[1] + _GAP + 40), _PAPER)
    draw = ImageDraw.Draw(sheet)
    for number, (picture, caption, detail) in enumerate(panels):
        row, column = divmod(number, columns)
        left, top = _GAP + column * step[0], _GAP + row * step[1]
        sheet.paste(_fitted(picture, size), (left, top))
        middle = left + size[0] // 2
        _write(draw, (middle, top + size[1] + 6), f"({ascii_lowercase[number]}) {caption}")
        _write(draw, (middle, top + size[1] + 31), detail, faint=True)
    _write(draw, (sheet.width // 2, sheet.height - 36), title, faint=True)
    return sheet


def _fitted(picture: Bytes, size: tuple[int, int]) -> Picture:
    from PIL import Image

    shown = Image.fromarray(picture)
    enlarged = shown.width < size[0]
    return shown.resize(size, Image.Resampling.NEAREST if enlarged else Image.Resampling.LANCZOS)


def _write(draw: ImageDraw, place: tuple[int, int], text: str, *, faint: bool = False) -> None:
    from PIL import ImageFont

    font = ImageFont.load_default(_DETAIL if faint else _CAPTION)
    draw.text(place, text, fill=_FAINT if faint else _INK, font=font, anchor="ma")
