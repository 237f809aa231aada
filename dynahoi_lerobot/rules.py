"""Rules: what decides how an episode plays and how it is seen, whichever episode it is and whoever
moves the hand.
"""

from dataclasses import dataclass
from typing import Any

from dynahoi_lerobot.captures import CAPTURES, CaptureRule
from dynahoi_lerobot.core.arguments import option
from dynahoi_lerobot.core.control_mode import CONTROL_MODES, JOINTS
from dynahoi_lerobot.core.conventions import DEFAULT_IMAGE_SIZE_PX, DETECTOR_IMAGE_SIZE_PX
from dynahoi_lerobot.core.features import ENVIRONMENT_STATES, EYE, Feature, frame_features
from dynahoi_lerobot.core.nested import as_json
from dynahoi_lerobot.core.protocols import (
    CONTROL_CLASSES,
    DEFAULT_CONTROL_CLASS,
    DEFAULT_PROTOCOL,
    PROTOCOLS,
    ControlClass,
)
from dynahoi_lerobot.core.registry import known, refuse_repeated
from dynahoi_lerobot.hands import HANDS
from dynahoi_lerobot.renderers import DEFAULT_RENDERER, RENDERERS
from dynahoi_lerobot.renderers.views import OPTIONAL_VIEWS

MAX_RENDER_NOISE = 64
IMAGE_SIZES_PX = (16, 1024)


@dataclass(frozen=True)
class Rules:
    """How an episode plays and how it is seen; datasets, results and checkpoints hold their rules.

    The text of a field is also the help of the option named after it. Scores compare only under
    equal values of the fields that are ``compared``; the others are a policy's own choice of what
    it sees and how it commands.
    """

    protocol: str = option(
        DEFAULT_PROTOCOL,
        f"observation protocol: {', '.join(PROTOCOLS)}",
        compared=True,
    )
    control_class: str = option(
        DEFAULT_CONTROL_CLASS,
        f"speed limits and command latency of the hand: {', '.join(CONTROL_CLASSES)}",
        compared=True,
    )
    control_mode: str = option(
        JOINTS,
        "action space: joints (palm position and 15 joint angles) or grasp (palm displacement and "
        "closure of the hand)",
    )
    capture: str = option(
        "attach", "capture rule: attach, attach_lenient or contact", compared=True
    )
    hand: str = option("", "hand model; by default the capture rule's", compared=True)
    image_size: int = option(
        DEFAULT_IMAGE_SIZE_PX, "side of the square images [px]; 0 renders none"
    )
    views: tuple[str, ...] = option(
        (),
        "comma-separated views in addition to ego, the hand's camera, such as side or ego_depth",
    )
    renderer: str = option(DEFAULT_RENDERER, "image renderer", compared=True)
    render_noise: int = option(
        0,
        "largest random change of each image value, in levels of 255; imitates another renderer",
        compared=True,
    )
    environment_state: str = option(
        "",
        "add observation.environment_state to the observations: truth, the target's pose and "
        "velocity; or eye, where a pretrained image encoder sees the target",
    )

    def __post_init__(self) -> None:
        """Check every name against what exists.

        Raises:
            ValueError: naming the value received and the ones allowed.
        """
        known("protocol", self.protocol, PROTOCOLS)
        known("control class", self.control_class, CONTROL_CLASSES)
        known("control mode", self.control_mode, CONTROL_MODES)
        known("environment_state", self.environment_state, ENVIRONMENT_STATES)
        for view in self.views:
            known("extra view", view, dict.fromkeys(OPTIONAL_VIEWS))
        CAPTURES.check(self.capture)
        HANDS.check(self.hand_name)
        RENDERERS.check(self.renderer)
        refuse_repeated("view", self.views)
        low, high = IMAGE_SIZES_PX
        if self.image_size and not low <= self.image_size <= high:
            raise ValueError(
                f"image_size must be {low} to {high} pixels, or 0 for no camera, got "
                f"{self.image_size}"
            )
        if self.environment_state == EYE and self.image_size not in (0, DETECTOR_IMAGE_SIZE_PX):
            raise ValueError(
                f"with environment_state {EYE}, image_size must be {DETECTOR_IMAGE_SIZE_PX}, or 0 "
                f"to show no images, got {self.image_size}"
            )
        if not 0 <= self.render_noise <= MAX_RENDER_NOISE:
            raise ValueError(
                f"render_noise must be 0 to {MAX_RENDER_NOISE} levels of 255, got "
                f"{self.render_noise}"
            )

    @property
    def capture_rule(self) -> type[CaptureRule]:
        """The capture rule."""
        return CAPTURES[self.capture]

    @property
    def control(self) -> ControlClass:
        """The limits of the hand and the latency of its commands."""
        return CONTROL_CLASSES[self.control_class]

    @property
    def hand_name(self) -> str:
        """The hand that plays."""
        return self.hand or self.capture_rule.hand

    @property
    def features(self) -> tuple[Feature, ...]:
        """The columns of the frame table of an episode under these rules, in the dataset's
        order.
        """
        return frame_features(
            self.image_size,
            self.views,
            control_mode=self.control_mode,
            contact_sensors=self.capture_rule.uses_contact_sensors,
            environment_state=self.environment_state,
        )

    def stored(self) -> dict[str, Any]:
        """Return the values as files hold them, with the hand named."""
        return as_json(self) | {"hand": self.hand_name}
