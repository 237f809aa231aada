"""The tables of damages: what is done to a dataset, the mode that finds it, and words of the finding."""

from tests.verify.damages.audit import AUDIT
from tests.verify.damages.constants import CONSTANTS
from tests.verify.damages.episodes import EPISODES
from tests.verify.damages.files import FILES
from tests.verify.damages.plans import PLANS
from tests.verify.damages.tables import TABLES
from tests.verify.damages.videos import VIDEOS

GROUPS = {
    "facts and poses": AUDIT,
    "values of episodes": EPISODES,
    "object, cameras, plan, outcome": CONSTANTS,
    "tables": TABLES,
    "files": FILES,
    "plan": PLANS,
    "pictures": VIDEOS,
}
DAMAGES = {name: damage for group in GROUPS.values() for name, damage in group.items()}
