"""The contact sheet of a comparison, laid out as SJ13 Fig. 6: methods, and below what they tell."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from string import ascii_lowercase
from textwrap import wrap
from typing import TYPE_CHECKING

from .images import Bytes

if TYPE_CHECKING:
    from PIL.Image import Image as Picture
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont, ImageFont

# Fewer panels are not shown any larger.
_LEAST_COLUMNS, _MOST_COLUMNS = 4, 5
Panel = tuple[Bytes, str, str]
# Panels are shown this wide, whatever the size of the pictures.
_PANEL = 480
_GAP = 12
# Above and below the lines of a text.
_MARGIN = 8
_PAPER = (255, 255, 255)


@dataclass(frozen=True)
class _Line:
    """One line of text, in pixels: its letters' size and the height it takes."""

    text: str
    size: int
    height: int
    ink: tuple[int, int, int]


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
    columns = min(max(_LEAST_COLUMNS, *map(len, groups)), _MOST_COLUMNS)
    rows = _rows(groups, columns)
    tops = [_GAP]
    for row in rows:
        tops.append(tops[-1] + size[1] + max(_height(lines) for _, lines in row))
    full = columns * (_PANEL + _GAP) + _GAP
    foot = _details(title, full - 2 * _GAP)
    sheet = Image.new("RGB", (full, tops[-1] + _height(foot)), _PAPER)
    draw = ImageDraw.Draw(sheet)
    for top, row in zip(tops[:-1], rows, strict=True):
        for column, (picture, lines) in enumerate(row):
            left = _GAP + column * (_PANEL + _GAP)
            sheet.paste(_fitted(picture, size), (left, top))
            _write(draw, (left + _PANEL // 2, top + size[1]), lines)
    _write(draw, (full // 2, tops[-1]), foot)
    return sheet


def _rows(groups: list[list[Panel]], columns: int) -> list[list[tuple[Bytes, list[_Line]]]]:
    """Return the pictures of each row, with the lines below each."""
    letters = iter(ascii_lowercase)
    return [
        [
            (
                picture,
                [*_captions(f"({next(letters)}) {caption}", _PANEL), *_details(detail, _PANEL)],
            )
            for picture, caption, detail in group[i : i + columns]
        ]
        for group in groups
        for i in range(0, len(group), columns)
    ]


def _captions(text: str, width: int) -> list[_Line]:
    return [_Line(line, 20, 26, (20, 20, 20)) for line in _wrapped(text, 20, width)]


def _details(text: str, width: int) -> list[_Line]:
    return [_Line(line, 15, 20, (95, 95, 95)) for line in _wrapped(text, 15, width)]


def _wrapped(text: str, size: int, width: int) -> list[str]:
    """Return text in lines that are no wider than so many pixels."""
    font, lines = _font(size), [text] if text else []
    for characters in range(len(text), 0, -1):
        lines = wrap(text, characters)
        if all(font.getlength(line) <= width for line in lines):
            break
    return lines


def _height(lines: Iterable[_Line]) -> int:
    return 2 * _MARGIN + sum(line.height for line in lines)


def _font(size: int) -> FreeTypeFont | ImageFont:
    from PIL import ImageFont

    return ImageFont.load_default(size)


def _fitted(picture: Bytes, size: tuple[int, int]) -> Picture:
    from PIL import Image

    shown = Image.fromarray(picture)
    enlarged = shown.width < size[0]
    return shown.resize(size, Image.Resampling.NEAREST if enlarged else Image.Resampling.LANCZOS)


def _write(draw: ImageDraw, place: tuple[int, int], lines: Iterable[_Line]) -> None:
    """Write lines one below the other; the place is the middle of where they begin."""
    x, y = place[0], place[1] + _MARGIN
    for line in lines:
        draw.text((x, y), line.text, fill=line.ink, font=_font(line.size), anchor="ma")
        y += line.height
