"""Mitsuba 3 scenes as trees of plugins, from XML or dictionaries."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..._util.validation import Floats, float_array

# Tags of values; all others are of plugins.
_VALUES = ("float", "integer", "boolean", "string", "rgb", "spectrum", "vector", "point")
_IGNORED = ("default", "path")
_UNREAD = ("include", "alias")
_MAX_DEPTH = 50
# Types of spectra that are a colour, by the name of what is in them, and its default.
_SPECTRA = {"uniform": ("value", 1.0), "srgb": ("color", 0.0), "d65": ("scale", 1.0)}


@dataclass
class Plugin:
    """A plugin: its tag, such as ``shape``, its type and what is in it.

    Methods raise ValueError if a value is not of the kind that they return.
    """

    tag: str
    kind: str
    identifier: str
    values: dict[str, Any] = field(default_factory=dict)
    children: dict[str, Plugin] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Tag, type and id, for messages."""
        return f"{self.tag} {self.identifier or self.kind!r}"

    def number(self, name: str, default: float) -> float:
        """A number."""
        try:
            return float(float_array(float(self.values.get(name, default)), name, ()))
        except (TypeError, ValueError):
            raise self._error(name, "a number") from None

    def colour(self, name: str, default: float) -> Floats:
        """A colour (3,): of one number, of three, or as #rrggbb; of a material's texture, none."""
        if name in self.children:
            return self._colour_of(self.children[name], name, default)
        value = self.values.get(name, default)
        try:
            array = _hexadecimal(value) if isinstance(value, str) else np.asarray(value, float)
            return float_array(np.broadcast_to(array, (3,)), name, (3,))
        except (TypeError, ValueError):
            raise self._error(name, "a colour of one number or three") from None

    def vector(self, name: str, default: tuple[float, float, float]) -> Floats:
        """A vector (3,)."""
        try:
            return float_array(np.asarray(self.values.get(name, default), float), name, (3,))
        except (TypeError, ValueError):
            raise self._error(name, "three numbers") from None

    def text(self, name: str, default: str) -> str:
        """Text."""
        return str(self.values.get(name, default))

    def flag(self, name: str, default: bool = False) -> bool:
        """True or false."""
        return self.values.get(name, default) in (True, "true", "True", "1")

    def transform(self) -> Floats:
        """``to_world`` (4, 4)."""
        return float_array(self.values.get("to_world", np.eye(4)), "to_world", (4, 4))

    def all_of(self, tag: str) -> list[Plugin]:
        """The children with a tag."""
        return [child for child in self.children.values() if child.tag == tag]

    def first_of(self, tag: str) -> Plugin | None:
        """The first child with a tag, None if there is none."""
        return next(iter(self.all_of(tag)), None)

    def _colour_of(self, child: Plugin, name: str, default: float) -> Floats:
        """Colour of a plugin in place of one; the default of a texture, which is told elsewhere."""
        if child.kind in _SPECTRA:
            return child.colour(*_SPECTRA[child.kind])
        if child.tag == "texture" and self.tag == "bsdf":
            return np.full(3, default)
        raise ValueError(f"{self.label}: {name} should be a colour, but is of type {child.kind!r}")

    def _error(self, name: str, expected: str) -> ValueError:
        return ValueError(
            f"{self.label}: {name} should be {expected}, but is {self.values.get(name)!r}"
        )


def parse_xml(content: bytes, arguments: Mapping[str, Any]) -> Plugin:
    """The scene of XML, with the values of its ``$names``.

    Raises
    ------
    ValueError
        If it is damaged, or has what is not read.
    """
    # Entities could make much of little, or name other files.
    if b"<!" in content.replace(b"<!--", b""):
        raise ValueError("document types and entities are not read")
    root = ET.fromstring(content)
    if root.tag != "scene":
        raise ValueError(f"the root should be a scene, but is a {root.tag}")
    names = {
        each.attrib.get("name", ""): each.attrib.get("value", "") for each in root.iter("default")
    }
    unknown = arguments.keys() - names.keys()
    if unknown:
        raise ValueError(
            f"arguments should be defaults of the scene, {', '.join(names) or 'which has none'}, "
            f"but are {', '.join(sorted(unknown))}"
        )
    names |= {name: str(value) for name, value in arguments.items()}
    return _XmlReader(names).plugin(root, 0)


class _XmlReader:
    """Reads elements; plugins with an id can be referred to by those that follow."""

    def __init__(self, names: Mapping[str, str]) -> None:
        # The longest first, as one name may begin another.
        self._names = sorted(names.items(), key=lambda item: -len(item[0]))
        self._known: dict[str, Plugin] = {}

    def plugin(self, element: ET.Element, depth: int) -> Plugin:
        """A plugin with all that is in it."""
        if depth > _MAX_DEPTH:
            raise ValueError(f"plugins should be nested in one another {_MAX_DEPTH} deep at most")
        made = Plugin(element.tag, self._text(element, "type"), self._text(element, "id"))
        for i, child in enumerate(element):
            name = self._text(child, "name")
            if child.tag in _VALUES and "type" not in child.attrib:
                made.values[name] = self._value(child)
            elif child.tag == "transform":
                made.values[name] = self._transform(child)
            elif child.tag == "ref":
                made.children[name or f"ref {i}"] = referred(self._known, self._text(child, "id"))
            elif child.tag in _UNREAD:
                raise ValueError(f"{child.tag} is not read: put all into one file")
            elif child.tag not in _IGNORED:
                made.children[name or f"{child.tag} {i}"] = self.plugin(child, depth + 1)
        if made.identifier:
            self._known[made.identifier] = made
        return made

    def _text(self, element: ET.Element, attribute: str) -> str:
        text = element.attrib.get(attribute, "")
        for name, value in self._names if "$" in text else ():
            text = text.replace(f"${name}", value)
        return text

    def _value(self, element: ET.Element) -> Any:
        text = self._text(element, "value")
        if element.tag in ("vector", "point"):
            return self._vector(element, 0.0)
        if element.tag in ("rgb", "spectrum") and not text.startswith("#"):
            if ":" in text or not text:
                held = text[:40] or element.attrib.get("filename", "")
                raise ValueError(f"{element.tag} should be of one value or three, but is {held!r}")
            return _numbers(text)
        return text

    def _vector(self, element: ET.Element, default: float) -> Floats:
        if "value" in element.attrib:
            return np.broadcast_to(_numbers(self._text(element, "value")), (3,))
        return np.array([float(self._text(element, axis) or default) for axis in "xyz"])

    def _transform(self, element: ET.Element) -> Floats:
        matrix = np.eye(4)
        for step in element:
            matrix = self._step(step) @ matrix
        return matrix

    def _step(self, step: ET.Element) -> Floats:
        """Matrix of one step of a transform."""
        if step.tag == "matrix":
            numbers = _numbers(self._text(step, "value"))
            if len(numbers) not in (9, 16):
                raise ValueError(f"matrix should have 9 or 16 numbers, but has {len(numbers)}")
            matrix = np.eye(4)
            side = 4 if len(numbers) == 16 else 3
            matrix[:side, :side] = numbers.reshape(side, side)
            return matrix
        if step.tag == "lookat":
            points = [_numbers(self._text(step, key)) for key in ("origin", "target", "up")]
            return look_at(*(float_array(each, "lookat", (3,)) for each in points))
        matrix = np.eye(4)
        if step.tag == "translate":
            matrix[:3, 3] = self._vector(step, 0.0)
        elif step.tag == "scale":
            matrix[:3, :3] = np.diag(self._vector(step, 1.0))
        elif step.tag == "rotate":
            angle = np.radians(float(self._text(step, "angle") or 0.0))
            matrix[:3, :3] = _rotation(self._vector(step, 0.0), angle)
        else:
            raise ValueError(f"{step.tag} is no transform that is read")
        return matrix


def parse_dict(value: Mapping[str, Any]) -> Plugin:
    """The scene of a dictionary as Mitsuba's ``load_dict`` takes it.

    Raises
    ------
    ValueError
        If it has no type, is nested too deeply, or refers to what is not before it.
    """
    return _DictReader().plugin(value, "", 0)


class _DictReader:
    """Reads dictionaries; plugins can be referred to, by key or id, by those that follow."""

    def __init__(self) -> None:
        self._known: dict[str, Plugin] = {}

    def plugin(self, value: Mapping[str, Any], name: str, depth: int) -> Plugin:
        """A plugin with all that is in it."""
        kind = value.get("type")
        if not isinstance(kind, str) or depth > _MAX_DEPTH:
            raise ValueError(f"{name or 'the scene'} should be a dictionary with a type")
        if kind == "ref":
            return referred(self._known, str(value.get("id", "")))
        made = Plugin(_tag_of(kind), kind, str(value.get("id", name)))
        for key, member in value.items():
            if not isinstance(member, Mapping):
                made.values[key] = _dict_value(member)
            elif member.get("type") in ("rgb", "spectrum") and "value" in member:
                made.values[key] = member["value"]
            else:
                made.children[key] = self.plugin(member, key, depth + 1)
        self._known |= {each: made for each in (name, made.identifier) if each}
        return made


def _dict_value(member: Any) -> Any:
    """The value of a member, a matrix (4, 4) of a transform."""
    matrix = getattr(member, "matrix", None)
    return member if matrix is None else np.array(matrix, float).reshape(4, 4)


def referred(known: Mapping[str, Plugin], identifier: str) -> Plugin:
    """The plugin with an id, of those so far; raises ValueError if there is none."""
    if identifier not in known:
        raise ValueError(f"ref should be of an id before it, but is of {identifier!r}")
    return known[identifier]


def look_at(origin: Floats, target: Floats, up: Floats) -> Floats:
    """Transform (4, 4) of a camera: z towards the target, x to the left."""
    forward = target - origin
    left = np.cross(up, forward)
    lengths = np.linalg.norm(forward), np.linalg.norm(left)
    if not min(lengths) > 0.0:
        raise ValueError("lookat should have a target apart from its origin, and an up across it")
    matrix = np.eye(4)
    forward, left = forward / lengths[0], left / lengths[1]
    matrix[:3, :3] = np.column_stack([left, np.cross(forward, left), forward])
    matrix[:3, 3] = origin
    return matrix


def _tag_of(kind: str) -> str:
    """Tag of a type, by the tables of those that are read."""
    for tag, kinds in KINDS.items():
        if kind in kinds:
            return tag
    return "plugin"


KINDS = {
    "scene": ("scene",),
    "shape": ("obj", "ply", "stl", "sphere", "rectangle", "cube", "disk", "cylinder"),
    "bsdf": (
        *("diffuse", "dielectric", "conductor", "twosided", "thindielectric", "plastic"),
        *("roughplastic", "roughconductor", "roughdielectric", "mask", "bumpmap", "normalmap"),
        *("principled", "null"),
    ),
    "emitter": ("point", "spot", "directional", "area", "constant", "envmap"),
    "sensor": ("perspective", "thinlens", "orthographic"),
    "texture": ("bitmap", "checkerboard", "mesh_attribute", "volume"),
    "film": ("hdrfilm", "specfilm"),
    "spectrum": ("spectrum", "rgb", "blackbody", "irregular", "regular", *_SPECTRA),
    "integrator": ("path", "direct", "volpath", "volpathmis", "ptracer", "aov", "prb"),
}


def _numbers(text: str) -> Floats:
    return np.array([float(each) for each in text.replace(",", " ").split()])


def _hexadecimal(text: str) -> Floats:
    """Linear colour of text like #ff8000, or of a number."""
    if not text.startswith("#"):
        return _numbers(text)
    stored = np.array([int(text[i : i + 2], 16) / 255.0 for i in (1, 3, 5)])
    return np.where(stored <= 0.04045, stored / 12.92, ((stored + 0.055) / 1.055) ** 2.4)


def _rotation(axis: Floats, angle: float) -> Floats:
    length = np.linalg.norm(axis)
    if not length > 0.0:
        raise ValueError("rotate should have an axis, but that is zero")
    x, y, z = axis / length
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned: Floats = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    return turned
