"""What a comparison leaves in a folder; its files take their places together or not at all."""

from __future__ import annotations

import io
from contextlib import ExitStack
from pathlib import Path

from ..._util.files import check_writable, whole_file, write_json
from ...estimation.methods import METHODS
from ..comparison import Comparison, Entry
from .contact_sheet import Panel, contact_sheet
from .images import Bytes, method_pictures, photon_pictures
from .page import page
from .table import Table, heads, table

PAGE, SHEET, NUMBERS, REFERENCE = "index.html", "sheet.png", "comparison.json", "reference.exr"
# What SJ13 Fig. 6 calls its panels.
_CAPTIONS = {
    "parameter-space": "Parameter space",
    "path-edges": "Path edges",
    "constraints": "Derived constraints",
}
_KINDS = ("flip", "difference")
_ENDS = (".exr", ".png", *(f"-{kind}.png" for kind in _KINDS))


def prepare_folder(folder: Path, methods: tuple[str, ...]) -> None:
    """Make a folder and see that files can be written there; better before the work than after.

    Raises
    ------
    OSError
        If it cannot be made or written to.
    """
    if folder.exists() and not folder.is_dir():
        raise NotADirectoryError(f"cannot write into {folder}: it is not a folder")
    if not folder.exists() and not folder.parent.is_dir():
        raise FileNotFoundError(f"cannot write {folder}: there is no folder {folder.parent}")
    folder.mkdir(exist_ok=True)
    pictures = [*methods, *(f"{method}-{kind}" for method in methods for kind in _KINDS)]
    for name in (PAGE, SHEET, NUMBERS, REFERENCE, *(f"{method}.exr" for method in methods)):
        check_writable(folder / name)
    for name in (*pictures, *_CAPTIONS, "reference"):
        check_writable(folder / f"{name}.png")


def write(comparison: Comparison, folder: Path) -> Table:
    """Write a comparison's pictures, contact sheet, numbers and page; return its table.

    Pictures of an earlier comparison that this one has none for are removed.
    """
    pictures, photons = method_pictures(comparison), photon_pictures(comparison)
    about, shown = comparison.to_dict(), table(comparison)
    flat = {name: made["picture"] for name, made in photons.items()}
    for method, kinds in pictures.items():
        flat |= {_file_name(method, kind): picture for kind, picture in kinds.items()}
    encoded = {name: _png(picture) for name, picture in flat.items()}
    placed: set[str] = set()
    with ExitStack() as files:

        def place(name: str) -> Path:
            placed.add(name)
            return files.enter_context(whole_file(folder / name))

        for entry in comparison.entries:
            entry.image.write_exr(place(f"{entry.name}.exr"))
        for name, content in encoded.items():
            place(f"{name}.png").write_bytes(content)
        sheet = contact_sheet(_panels(comparison, flat), shown.title)
        sheet.save(place(SHEET), "PNG")
        write_json(place(NUMBERS), about)
        html = page(
            about,
            shown.to_dict(),
            {
                method: {kind: encoded[_file_name(method, kind)] for kind in kinds}
                for method, kinds in pictures.items()
            },
            [
                {"name": name, "picture": encoded[name], "about": made["about"]}
                for name, made in photons.items()
            ],
        )
        place(PAGE).write_text(html, encoding="utf-8")
    for name in _known_names() - placed:
        (folder / name).unlink(missing_ok=True)
    return shown


def _file_name(method: str, kind: str) -> str:
    """Return what the file of a picture is called, but for its suffix."""
    return method if kind == "picture" else f"{method}-{kind}"


def _png(picture: Bytes) -> bytes:
    """Return a picture (height, width, 3) as a PNG file."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(picture).save(file, "PNG", optimize=True)
    return file.getvalue()


def _known_names() -> set[str]:
    """Return the names of all pictures that any comparison writes, but for the reference's own."""
    of_methods = {f"{method}{end}" for method in METHODS for end in _ENDS}
    return of_methods | {f"{name}.png" for name in _CAPTIONS}


def _panels(comparison: Comparison, pictures: dict[str, Bytes]) -> list[list[Panel]]:
    """Return the panels of the contact sheet: methods; what photons carry, and the reference."""
    entries = comparison.entries
    of_methods = [
        (pictures[e.name], head, _detail(e))
        for e, head in zip(entries, heads(entries), strict=True)
    ]
    of_photons = [
        (pictures[name], caption, "") for name, caption in _CAPTIONS.items() if name in pictures
    ]
    reference = (pictures["reference"], "Reference", comparison.reference.description)
    return [of_methods, [*of_photons, reference]]


def _detail(entry: Entry) -> str:
    errors, seconds = entry.errors, sum(entry.seconds.values())
    return (
        f"L1 {errors.relative_l1:.1%}, SSIM {errors.ssim:.3f}, FLIP {errors.flip:.3f}, "
        f"{seconds:.1f} s"
    )
