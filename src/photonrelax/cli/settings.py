"""Settings of stages from options: ``STAGE.FIELD=VALUE``, and options of their own."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import fields, replace
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

from ..estimation.methods import METHODS, SETTINGS_CLASSES, Settings

# Options that set a field, as ``STAGE.FIELD``.
_OWN_OPTIONS = {"refinement": "gather.refinement", "iterations": "relax.n_iterations"}
Assignment = tuple[str, str, Any]


def assignment(text: str) -> Assignment:
    """Stage, field and value of ``STAGE.FIELD=VALUE``; ``none`` is None.

    Raises
    ------
    argparse.ArgumentTypeError
        If there is no such stage or field, or the value is not of its type.
    """
    name, equals, value = text.partition("=")
    stage, dot, field = name.strip().partition(".")
    if not (equals and dot):
        raise argparse.ArgumentTypeError(f"should be STAGE.FIELD=VALUE, but is {text!r}")
    if stage not in SETTINGS_CLASSES:
        raise argparse.ArgumentTypeError(
            f"the stage should be one of {', '.join(SETTINGS_CLASSES)}, but is {stage!r}"
        )
    names = [each.name for each in fields(SETTINGS_CLASSES[stage])]
    if field not in names:
        raise argparse.ArgumentTypeError(
            f"the setting of {stage} should be one of {', '.join(names)}, but is {field!r}"
        )
    try:
        found = _value(value.strip(), get_type_hints(SETTINGS_CLASSES[stage])[field])
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{stage}.{field} should be {error}") from None
    return stage, field, found


def _value(text: str, kind: Any) -> Any:
    """Value of a type from text; raises ValueError with the expected kind of value."""
    if get_origin(kind) is tuple:
        parts, kinds = text.split(","), get_args(kind)
        if len(parts) != len(kinds):
            raise ValueError(f"{len(kinds)} numbers with commas between, but is {text!r}")
        return tuple(_value(part, each) for part, each in zip(parts, kinds, strict=True))
    members = get_args(kind) or (kind,)
    if NoneType in members and text.lower() == "none":
        return None
    words = [word for member in members for word in get_args(member)]
    if str in members or text in words:
        return text
    return _number(text, float in members)


def _number(text: str, fractions: bool) -> int | float:
    try:
        number = float(text) if fractions else _whole(text)
        if number != number:
            raise ValueError
        return number
    except ValueError:
        kind = "number" if fractions else "whole number"
        raise ValueError(f"a {kind}, but is {text!r}") from None


def _whole(text: str) -> int:
    """Whole number, also one written like 2e6; exact however many digits it has."""
    try:
        return int(text)
    except ValueError:
        number = float(text)
    if not number.is_integer():
        raise ValueError
    return int(number)


def settings_from_options(
    options: argparse.Namespace, methods: Iterable[str], stages_of_k: Iterable[str] = ("gather",)
) -> Settings:
    """Settings of given options; ends with wrong usage if no method reads one of them.

    Parameters
    ----------
    options : Namespace
        With `set`, `k`, `refinement` and `iterations`, each None if it is not given.
    methods : iterable of str
        The methods to run.
    stages_of_k : iterable of str
        Stages whose k is set by ``--k``.
    """
    methods = tuple(methods)
    read = {stage for method in methods for stage in METHODS[method].stages}
    values: dict[str, dict[str, Any]] = {}
    for option, places in _assignments(options, read & {*stages_of_k} or {*stages_of_k}):
        for stage, field, value in places:
            if stage not in read:
                options.wrong_usage(
                    f"{option} sets {stage}.{field}, which {', '.join(methods)} "
                    f"{'does' if len(methods) == 1 else 'do'} not read: "
                    f"leave it out, or --set something of {', '.join(sorted(read))}"
                )
            if field in values.setdefault(stage, {}):
                options.wrong_usage(f"{stage}.{field} is given twice")
            values[stage][field] = value
    return Settings(
        **{stage: replace(_default(stage, methods), **each) for stage, each in values.items()}
    )


def _default(stage: str, methods: tuple[str, ...]) -> Any:
    """Settings of a stage where none are given; those of its class if methods differ in them."""
    readers = [METHODS[name] for name in methods if stage in METHODS[name].stages]
    first, *others = [method.default(stage) for method in readers]
    return first if all(each == first for each in others) else SETTINGS_CLASSES[stage]()


def _assignments(
    options: argparse.Namespace, stages_of_k: Iterable[str]
) -> Iterable[tuple[str, list[Assignment]]]:
    """Given options, and the assignments each makes."""
    for each in options.set or ():
        yield f"--set {each[0]}.{each[1]}", [each]
    if options.k is not None:
        yield "--k", [(stage, "k", options.k) for stage in sorted(stages_of_k)]
    for option, place in _OWN_OPTIONS.items():
        value = getattr(options, option)
        if value is not None:
            stage, field = place.split(".")
            yield f"--{option}", [(stage, field, tuple(value) if stage == "relax" else value)]
