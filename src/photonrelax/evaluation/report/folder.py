"""Files of a comparison; they replace those of an earlier one together or not at all."""

from __future__ import annotations

import io
from contextlib import ExitStack
from pathlib import Path

from ..._util.files import make_folder, whole_file, write_json
from ...estimation.methods import METHODS
from ..comparison import Comparison, Entry
from .contact_sheet import Panel, contact_sheet
from .images import PHOTON_ATTRIBUTES, Bytes, PhotonImage, method_images, photon_images
from .page import page
from .table import Table, column_titles, table

PAGE, SHEET, NUMBERS, REFERENCE = "index.html", "sheet.png", "comparison.json", "reference.exr"
_ERROR_MAPS = ("flip", "difference")


def prepare_folder(folder: Path, methods: tuple[str, ...]) -> None:
    """Make the folder of a comparison, before the work; see `make_folder`."""
    names = {name for method in methods for name in _method_files(method)}
    make_folder(
        folder, (PAGE, SHEET, NUMBERS, REFERENCE, "reference.png", *names, *_photon_files())
    )


def image_names() -> set[str]:
    """Names of images of all methods, which a comparison replaces or removes."""
    return {name for method in METHODS for name in _method_files(method)}.union(_photon_files())


def write(comparison: Comparison, folder: Path) -> Table:
    """Write the images, contact sheet, numbers and page of a comparison; return its table.

    Images that only an earlier comparison has are removed.
    """
    images, photons = method_images(comparison), photon_images(comparison)
    shown = table(comparison)
    flat = _flat(images, photons)
    encoded = {name: _png(image) for name, image in flat.items()}
    html = _html(comparison, shown, photons, encoded)
    placed: set[str] = set()
    with ExitStack() as files:

        def place(name: str) -> Path:
            placed.add(name)
            return files.enter_context(whole_file(folder / name))

        for entry in comparison.entries:
            entry.image.write_exr(place(f"{entry.name}.exr"))
        for name, content in encoded.items():
            place(f"{name}.png").write_bytes(content)
        contact_sheet(_panels(comparison, flat), shown.title).save(place(SHEET), "PNG")
        write_json(place(NUMBERS), comparison.to_dict())
        place(PAGE).write_text(html, encoding="utf-8")
    _remove_others(folder, placed)
    return shown


def _html(
    comparison: Comparison,
    shown: Table,
    photons: dict[str, PhotonImage],
    encoded: dict[str, bytes],
) -> str:
    kinds = {
        entry.name: {kind: encoded[_stem(entry.name, kind)] for kind in ("image", *_ERROR_MAPS)}
        for entry in comparison.entries
    }
    return page(
        comparison.to_dict(),
        shown.to_dict(),
        {**kinds, "reference": {"image": encoded["reference"]}},
        [
            {"name": name, "image": encoded[name], "about": photon_image.about}
            for name, photon_image in photons.items()
        ],
    )


def _flat(images: dict[str, dict[str, Bytes]], photons: dict[str, PhotonImage]) -> dict[str, Bytes]:
    """All images by the stems of their file names."""
    flat = {name: photon_image.image for name, photon_image in photons.items()}
    for method, kinds in images.items():
        flat |= {_stem(method, kind): image for kind, image in kinds.items()}
    return flat


def _stem(method: str, kind: str) -> str:
    """Name of the file of an image, without its suffix."""
    return method if kind == "image" else f"{method}-{kind}"


def _method_files(method: str) -> list[str]:
    return [f"{method}.exr", *(f"{_stem(method, kind)}.png" for kind in ("image", *_ERROR_MAPS))]


def _photon_files() -> list[str]:
    return [f"{name}.png" for name in PHOTON_ATTRIBUTES]


def _remove_others(folder: Path, placed: set[str]) -> None:
    """Remove the images that comparisons of other methods have written."""
    for name in image_names() - placed:
        (folder / name).unlink(missing_ok=True)


def _png(image: Bytes) -> bytes:
    """An image (height, width, 3) as a PNG file."""
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG", optimize=True)
    return file.getvalue()


def _panels(comparison: Comparison, images: dict[str, Bytes]) -> list[list[Panel]]:
    """Panels of the contact sheet: methods; photon attributes and the reference."""
    entries = comparison.entries
    methods = [
        (images[entry.name], title, _detail(entry))
        for entry, title in zip(entries, column_titles(entries), strict=True)
    ]
    photons = [
        (images[name], attribute.caption, "")
        for name, attribute in PHOTON_ATTRIBUTES.items()
        if name in images
    ]
    reference = (images["reference"], "Reference", comparison.reference.description)
    return [methods, [*photons, reference]]


def _detail(entry: Entry) -> str:
    errors, seconds = entry.errors, sum(entry.seconds.values())
    return (
        f"L1 {errors.relative_l1:.1%}, SSIM {errors.ssim:.3f}, FLIP {errors.flip:.3f}, "
        f"{seconds:.1f} s"
    )
