"""Methods side by side: the same photons, the same points of a picture, the same reference.

`compare` makes a `Comparison` (`run.py`) on a scene or on photons alone (`subject.py`), measured
against a reference (`reference.py`); `folder.py` writes it: pictures (`pictures.py`), a contact
sheet (`sheet.py`), a table (`table.py`), and a page (`page.py`, `page.html`).
"""

from .run import METHODS_OF_SJ13 as METHODS_OF_SJ13
from .run import Comparison as Comparison
from .run import Entry as Entry
from .run import Plan as Plan
from .run import compare as compare
from .subject import DistributionSubject as DistributionSubject
from .subject import SceneSubject as SceneSubject
