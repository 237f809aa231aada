"""Configs of the simulated robot and its teleoperators."""

from dataclasses import dataclass, field
from pathlib import Path

from lerobot.robots import RobotConfig
from lerobot.teleoperators import TeleoperatorConfig

from dynahoi_lerobot.core.nested import changed, field_names
from dynahoi_lerobot.sampling.recipe import Recipe
from dynahoi_lerobot.sampling.splits import kind_seed


@RobotConfig.register_subclass("dynahoi")
@dataclass(kw_only=True)
class DynahoiRobotConfig(RobotConfig):
    """A world of the DynaHOI benchmark behind LeRobot's robot interface.

    Attributes:
        split: stream of episodes: val, test, test_small, train, twins or one of the ood_ splits.
        task: the kind of motion; None for all kinds of the split in turn.
        seed: number of the first episode within split and kind; the next episodes count up.
        control_class: limits and latency of the hand; `dynahoi list control-classes` has them.
        capture: capture rule: attach, attach_lenient or contact.
        hand: the hand; the capture rule's if empty.
        image_size: side of the camera images [px].
        views: cameras besides ``ego``.
        realtime: whether the world moves at 20 Hz by the clock; else every action moves it by one
            frame.
        restart_s: after an episode has ended, the next one begins this much later [s], never if
            ``inf``; None if LeRobot begins episodes, as it does when it records.
        results_dir: where metrics are written, as by ``dynahoi evaluate``, and resumed; nowhere if
            None.
        player: who moves the hand, in those results.
    """

    split: str = "val"
    task: str | None = None
    seed: int = 0
    control_class: str = "standard"
    capture: str = "attach"
    hand: str = ""
    image_size: int = 96
    views: list[str] = field(default_factory=list)
    realtime: bool = True
    restart_s: float | None = None
    results_dir: Path | None = None
    player: str = "lerobot"

    def __post_init__(self) -> None:
        """Check all names.

        Raises:
            ValueError: for an unknown name or value, naming what there is.
        """
        super().__post_init__()
        if not self.image_size:
            raise ValueError(
                "robot.image_size is 0, but the robot needs its camera; set it to 32 or more"
            )
        kind_seed(self.recipe, self.task, self.seed)

    @property
    def recipe(self) -> Recipe:
        """The episodes."""
        names = set(field_names(Recipe)) & vars(self).keys()
        return changed(Recipe(), {name: getattr(self, name) for name in names})


@TeleoperatorConfig.register_subclass("dynahoi_expert")
@dataclass(kw_only=True)
class DynahoiExpertConfig(TeleoperatorConfig):
    """The privileged expert of the capture rule moves the connected ``dynahoi`` robot of this
    process.
    """


@TeleoperatorConfig.register_subclass("dynahoi_browser")
@dataclass(kw_only=True)
class DynahoiBrowserConfig(TeleoperatorConfig):
    """A person at a web page moves the connected ``dynahoi`` robot of this process.

    Attributes:
        host, port: where the page is served; the printed address holds a token if others can reach
            the host.
    """

    host: str = "127.0.0.1"
    port: int = 8765
