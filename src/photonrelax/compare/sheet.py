"""The contact sheet of a comparison, laid out as SJ13 Fig. 6: methods, and below what they tell."""

from __future__ import annotations

from string import ascii_lowercase
from textwrap import wrap
from typing import TYPE_CHECKING

from .pictures import Bytes

if TYPE_CHECKING:
    from PIL.Image import Image as Picture
    from PIL.ImageDraw import ImageDraw

# Fewer panels are not shown any larger.
_LEAST_COLUMNS, _MOST_COLUMNS = 4, 5
Panel = tuple[Bytes, str, str]
# Panels are shown this wide, whatever the size of the pictures.
_PANEL = 480
_GAP = 12
_CAPTION, _DETAIL = 20, 15
_BELOW = 80
# Characters of a detail that fit below a panel.
_LINE = 60
_PAPER, _INK, _FAINT = (255, 255, 255), (20, 20, 20), (95, 95, 95)


def contact_sheet(groups: list[list[Panel]], title: str) -> Picture:
    """Return panels of pictures, captions and details below each.

    Parameters
    ----------
    groups : list of lists of (picture, caption, detail)
        Panels from left to right and top to bottom, each group beginning a row; pictures are
        (height, width, 3), all of one size.
    title : str
        Below all of them.
    """
    from PIL import Image, ImageDraw

    height, width = groups[0][0][0].shape[:2]
    size = (_PANEL, max(round(_PANEL * height / width), 1))
    step = (size[0] + _GAP, size[1] + _BELOW)
    columns = min(max(_LEAST_COLUMNS, *map(len, groups)), _MOST_COLUMNS)
    rows = [group[i : i + columns] for group in groups for i in range(0, len(group), columns)]
    sheet = Image.new("RGB", (columns * step[0] + _GAP, len(rows) * step[1] + _GAP + 40), _PAPER)
    draw, letters = ImageDraw.Draw(sheet), iter(ascii_lowercase)
    for row, panels in enumerate(rows):
        for column, (picture, caption, detail) in enumerate(panels):
            left, top = _GAP + column * step[0], _GAP + row * step[1]
            sheet.paste(_fitted(picture, size), (left, top))
            middle = left + size[0] // 2
            _write(draw, (middle, top + size[1] + 6), f"({next(letters)}) {caption}")
            lines = "\n".join(wrap(detail, _LINE))
            _write(draw, (middle, top + size[1] + 31), lines, faint=True)
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
    draw.text(place, text, fill=_FAINT if faint else _INK, font=font, anchor="ma", align="center")
