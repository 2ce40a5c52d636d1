"""The contact sheet: panels in rows, and text that leaves panels and other text alone."""

from itertools import combinations

import numpy as np
import pytest
from PIL import Image as PILImage
from PIL import ImageDraw

from photonrelax.evaluation.report.contact_sheet import contact_sheet

GREY = [np.full((30, 40, 3), 40 * i, dtype=np.uint8) for i in range(7)]
DETAIL = "L1 12.3%, SSIM 0.987, FLIP 0.123, 12.3 s"
REFERENCE = (
    "progressive photon mapping, two runs of 1,000 passes of 1,000,000 photons (1,234,567,890 "
    "absorbed), discs of 4 photons at first; its own noise 12.3% (L1), 12.3% (L2), its bias about "
    "12.3%, 12.3%"
)
TITLE = "ring: 1,000,000 photons emitted (halton, seed 0), 600 x 600 pixels of 4 samples"


@pytest.fixture
def drawn(monkeypatch):
    """Boxes of what is drawn as (left, top, right, bottom): panels, and texts with their words."""
    panels, texts = [], []
    paste, text = PILImage.Image.paste, ImageDraw.ImageDraw.text

    def pasting(sheet, image, place, *a, **k):
        panels.append((*place, place[0] + image.width, place[1] + image.height))
        return paste(sheet, image, place, *a, **k)

    def writing(draw, place, words, fill=None, **how):
        if words:
            texts.append((draw.textbbox(place, words, **how), words))
        return text(draw, place, words, fill=fill, **how)

    monkeypatch.setattr(PILImage.Image, "paste", pasting)
    monkeypatch.setattr(ImageDraw.ImageDraw, "text", writing)
    return panels, texts


def disjoint(one, other):
    return one[2] <= other[0] or other[2] <= one[0] or one[3] <= other[1] or other[3] <= one[1]


def words_of(drawn):
    return " ".join(" ".join(words.split()) for _, words in drawn[1])


@pytest.mark.parametrize(
    ("caption", "detail", "title"),
    [
        ("isotropic-diffusion, split passes", DETAIL, TITLE),
        ("parameterised", f"{REFERENCE}; {REFERENCE}", TITLE),
        ("k = 50, " * 20, "W" * 200, TITLE * 5),
        ("name", "", ""),
    ],
    ids=["as usual", "long details", "long everything", "nothing"],
)
def test_text_leaves_panels_and_other_text_alone(caption, detail, title, drawn):
    methods = [(image, caption, detail) for image in GREY[:6]]
    sheet = contact_sheet([methods, [(GREY[6], "Reference", REFERENCE)]], title)
    panels, texts = drawn
    boxes = [*panels, *(box for box, _ in texts)]
    assert len(panels) == 7
    for box in boxes:
        assert box[0] >= 0
        assert box[1] >= 0
        assert box[2] <= sheet.width
        assert box[3] <= sheet.height
    for one, other in combinations(boxes, 2):
        assert disjoint(one, other)
    said = words_of(drawn)
    for words in (REFERENCE, f"(g) Reference {REFERENCE}"):
        assert words in said


def test_text_stands_below_its_panel(drawn):
    contact_sheet([[(GREY[0], "one", DETAIL), (GREY[1], "two", REFERENCE)]], TITLE)
    panels, texts = drawn
    for panel, words in zip(panels, ("one", "two"), strict=True):
        box = next(box for box, text in texts if words in text)
        assert panel[0] <= box[0] < box[2] <= panel[2]
        assert 0 < box[1] - panel[3] < 20


def test_groups_of_the_contact_sheet_begin_rows(drawn):
    """Six panels of one group are five and one; captions leave the images alone."""
    words = "the caption of an image " * 4
    groups = [[(image, "name", words) for image in GREY[:6]], [(GREY[6], "name", words)]]
    made = np.asarray(contact_sheet(groups, "title"))
    assert made.shape[1] == 5 * (480 + 12) + 12
    tops = sorted({top for _, top, *_ in drawn[0]})
    assert len(tops) == 3
    for i, (row, column) in enumerate([*((0, c) for c in range(5)), (1, 0), (2, 0)]):
        left, top = 12 + column * (480 + 12), tops[row]
        assert (made[top : top + 360, left : left + 480] == 40 * i).all()
    assert (made[12:372, -12:] == 255).all()
