"""Contact sheet of a comparison, laid out as SJ13 Fig. 6: images with captions below them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from string import ascii_lowercase
from textwrap import wrap
from typing import TYPE_CHECKING

from ..._util.text import encodable
from .images import Bytes

if TYPE_CHECKING:
    from PIL.Image import Image as PILImage
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont, ImageFont

Panel = tuple[Bytes, str, str]
"""Image (height, width, 3), caption and detail."""

_MIN_COLUMNS, _MAX_COLUMNS = 4, 5
# Width of panels, to which images are resized, in pixels.
_PANEL = 480
_GAP = 12
# Above and below the lines of a text.
_MARGIN = 8
_BACKGROUND = (255, 255, 255)


@dataclass(frozen=True)
class _Line:
    """A line of text; font size and line height in pixels."""

    text: str
    size: int
    height: int
    colour: tuple[int, int, int]


def contact_sheet(groups: list[list[Panel]], title: str) -> PILImage:
    """Image of panels, with a caption and a detail below each.

    Parameters
    ----------
    groups : list of lists of (image, caption, detail)
        Panels from left to right and top to bottom; each group begins a row. Images are
        (height, width, 3), all of one size.
    title : str
        Text below all panels.
    """
    from PIL import Image, ImageDraw

    height, width = groups[0][0][0].shape[:2]
    size = (_PANEL, max(round(_PANEL * height / width), 1))
    columns = min(max(_MIN_COLUMNS, *map(len, groups)), _MAX_COLUMNS)
    rows = _rows(groups, columns)
    tops = [_GAP]
    for row in rows:
        tops.append(tops[-1] + size[1] + max(_height(lines) for _, lines in row))
    full = columns * (_PANEL + _GAP) + _GAP
    title_lines = _details(title, full - 2 * _GAP)
    sheet = Image.new("RGB", (full, tops[-1] + _height(title_lines)), _BACKGROUND)
    draw = ImageDraw.Draw(sheet)
    for top, row in zip(tops[:-1], rows, strict=True):
        for column, (image, lines) in enumerate(row):
            left = _GAP + column * (_PANEL + _GAP)
            sheet.paste(_resized(image, size), (left, top))
            _write(draw, (left + _PANEL // 2, top + size[1]), lines)
    _write(draw, (full // 2, tops[-1]), title_lines)
    return sheet


def _rows(groups: list[list[Panel]], columns: int) -> list[list[tuple[Bytes, list[_Line]]]]:
    """Images of each row, with the lines below each."""
    letters = iter(ascii_lowercase)
    return [
        [
            (
                image,
                [*_captions(f"({next(letters)}) {caption}", _PANEL), *_details(detail, _PANEL)],
            )
            for image, caption, detail in group[i : i + columns]
        ]
        for group in groups
        for i in range(0, len(group), columns)
    ]


def _captions(text: str, width: int) -> list[_Line]:
    return [_Line(line, 20, 26, (20, 20, 20)) for line in _wrapped(text, 20, width)]


def _details(text: str, width: int) -> list[_Line]:
    return [_Line(line, 15, 20, (95, 95, 95)) for line in _wrapped(text, 15, width)]


def _wrapped(text: str, size: int, width: int) -> list[str]:
    """Text in lines of a font size that are no wider than a number of pixels."""
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


def _resized(image: Bytes, size: tuple[int, int]) -> PILImage:
    from PIL import Image

    full = Image.fromarray(image)
    enlarged = full.width < size[0]
    return full.resize(size, Image.Resampling.NEAREST if enlarged else Image.Resampling.LANCZOS)


def _write(draw: ImageDraw, top: tuple[int, int], lines: Iterable[_Line]) -> None:
    """Write centred lines one below the other; `top` is the middle of their upper border."""
    x, y = top[0], top[1] + _MARGIN
    for line in lines:
        text = encodable(line.text)
        draw.text((x, y), text, fill=line.colour, font=_font(line.size), anchor="ma")
        y += line.height
