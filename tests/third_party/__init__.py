"""What a third party's package would hold: importing it registers a motion and an object, outside the core's tree."""

from tests.third_party import caltrop, drift

__all__ = ["caltrop", "drift"]
