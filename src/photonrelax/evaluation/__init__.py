"""Comparison of methods on the same photons and hit points, against the same reference.

`compare` evaluates a `ComparisonRequest` (`request.py`) of a scene or a photon pattern
(`subject.py`) into a `Comparison` (`comparison.py`), with errors against a reference
(`reference.py`, `analytic_pixels.py`); `report/` writes it to a folder.
"""

from ..estimation.methods import COMPARED_METHODS as COMPARED_METHODS
from .comparison import Comparison as Comparison
from .comparison import Entry as Entry
from .comparison import compare as compare
from .comparison import run_methods as run_methods
from .request import ComparisonRequest as ComparisonRequest
from .subject import PhotonPatternSubject as PhotonPatternSubject
from .subject import SceneSubject as SceneSubject
from .subject import gallery_subject as gallery_subject
