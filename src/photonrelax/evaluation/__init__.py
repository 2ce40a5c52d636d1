"""Methods side by side: the same photons, the same points of a picture, the same reference.

`compare` makes a `Comparison` (`run.py`) as planned (`plan.py`), on a scene or on photons alone
(`subject.py`), measured against a reference (`reference.py`, `truth.py`); `folder.py` writes it:
pictures (`pictures.py`), a contact sheet (`sheet.py`), a table (`table.py`), and a page (`page.py`,
`page.html`).
"""

from ..estimation.methods import METHODS_OF_SJ13 as METHODS_OF_SJ13
from .comparison import Comparison as Comparison
from .comparison import Entry as Entry
from .comparison import compare as compare
from .comparison import run_methods as run_methods
from .request import Plan as Plan
from .subject import DistributionSubject as DistributionSubject
from .subject import SceneSubject as SceneSubject
from .subject import named as named
