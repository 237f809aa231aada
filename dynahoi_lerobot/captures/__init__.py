"""Capture rules: what happens when the hand reaches the target, and what counts as a catch."""

from dynahoi_lerobot.captures.base import CAPTURES, CaptureRule, Release, Track, Weld

__all__ = ["CAPTURES", "CaptureRule", "Release", "Track", "Weld"]
