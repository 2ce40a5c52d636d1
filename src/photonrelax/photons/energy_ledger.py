"""Balance of the emitted flux by outcome of the paths."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._util.frozen import Ints, frozen, set_field
from .._util.npz import check_names
from .._util.validation import Floats, float_array, int_array

# Outcomes of paths, and of the flux they carry: fields of EnergyLedger, in the kernel's order.
PATH_OUTCOMES = ("stored", "absorbed", "escaped", "cut", "discarded")
LEDGER_NAMES = (
    "ledger_emitted",
    *(f"ledger_{name}" for name in PATH_OUTCOMES),
    *(f"ledger_ends_{name}" for name in PATH_OUTCOMES),
)
"""Names of a ledger's arrays in a photon map's file."""


@dataclass(frozen=True, eq=False)
class EnergyLedger:
    """Flux emitted by each emitter, divided by outcome; emitted is the sum of the others.

    Light goes on beyond sensors, so they are no outcome: of caustics, `stored` is the flux of the
    photons that are not on sensors, ``photons.flux[~photons.on_sensor].sum(axis=0)``, and the flux
    that crossed sensors is that of the others.

    Attributes
    ----------
    emitted : (n_emitters, 3) float64
        Flux of all paths started, W.
    stored : (n_emitters, 3) float64
        Flux that stayed where a photon was stored: all of it where the path ends there, otherwise
        incident flux less scattered (which may be more, for paths that survive roulette).
    absorbed : (n_emitters, 3) float64
        Flux lost to mirrors and to absorbing media.
    escaped : (n_emitters, 3) float64
        Flux that left the scene.
    cut : (n_emitters, 3) float64
        Flux of paths that were cut after `max_bounces` events.
    discarded : (n_emitters, 3) float64
        Flux that stayed on a diffuse surface as light of a kind that is not stored; and what white
        light had more than its wavelengths together, where it was dispersed.
    ends : mapping of str to (n_emitters,) int64
        Number of paths that ended as stored, absorbed, escaped, cut and discarded; those that were
        dispersed by the end of their shortest wavelength.
    """

    emitted: Floats
    stored: Floats
    absorbed: Floats
    escaped: Floats
    cut: Floats
    discarded: Floats
    ends: Mapping[str, Ints]

    def __post_init__(self) -> None:
        shape = (len(float_array(self.emitted, "emitted", (None, 3))), 3)
        for name in ("emitted", *PATH_OUTCOMES):
            set_field(self, name, frozen(float_array(getattr(self, name), name, shape)))
        if set(self.ends) != set(PATH_OUTCOMES):
            raise ValueError(
                f"ends should have the keys {PATH_OUTCOMES}, but has {tuple(self.ends)}"
            )
        ends = {
            k: frozen(int_array(self.ends[k], f"ends[{k!r}]", shape[:1])) for k in PATH_OUTCOMES
        }
        if any(number.min(initial=0) < 0 for number in ends.values()):
            raise ValueError("ends should hold numbers of paths, but one is negative")
        set_field(self, "ends", ends)

    @property
    def imbalance(self) -> float:
        """Largest difference between emitted and accounted flux, relative to the emitted."""
        accounted = np.sum([getattr(self, name) for name in PATH_OUTCOMES], axis=0)
        scale = np.maximum(self.emitted, np.finfo(np.float64).tiny)
        return float((np.abs(self.emitted - accounted) / scale).max(initial=0.0))

    def to_dict(self) -> dict[str, Any]:
        """Return lists and numbers, for JSON."""
        flux = {name: getattr(self, name).tolist() for name in ("emitted", *PATH_OUTCOMES)}
        return {**flux, "ends": {name: self.ends[name].tolist() for name in PATH_OUTCOMES}}

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> EnergyLedger:
        """The ledger of which `to_dict` is the content; raises KeyError if some is missing."""
        flux = {name: content[name] for name in ("emitted", *PATH_OUTCOMES)}
        return cls(**flux, ends=content["ends"])


def ledger_arrays(ledger: EnergyLedger) -> dict[str, NDArray]:
    """Return the arrays of a ledger in a photon map's file."""
    flux = {f"ledger_{name}": getattr(ledger, name) for name in ("emitted", *PATH_OUTCOMES)}
    return flux | {f"ledger_ends_{name}": ledger.ends[name] for name in PATH_OUTCOMES}


def ledger_from(arrays: Mapping[str, NDArray]) -> EnergyLedger:
    """Return the ledger in a photon map's file; raises ValueError if an array is missing."""
    check_names(arrays, LEDGER_NAMES)
    return EnergyLedger(
        **{name: arrays[f"ledger_{name}"] for name in ("emitted", *PATH_OUTCOMES)},
        ends={name: arrays[f"ledger_ends_{name}"] for name in PATH_OUTCOMES},
    )
