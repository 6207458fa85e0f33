"""Names of folders and videos that people give to cameras, rather than to trajectories."""

import re

_DEVICE = re.compile(
    r"""
    \w*cams? | \w*cameras? | \w*views? | lens | sensor | kinect | realsense | zed | azure | orbbec | oak | basler
    | logitech | gopro | usb | phone | iphone | ipad | images? | imgs? | pictures? | pics? | photos? | frames? | pixels
    | video | observation | colou?r | rgb | gr[ae]y | depth | ir | infrared | mono | stereo | fisheye
    """,
    re.VERBOSE,
)
_PLACE = re.compile(
    r"""
    left | right | top | bottom | upper | lower | high | low | front | back | rear | side | cent(?:er|re|ral)
    | overhead | ceiling | bird | birdseye | ego | egocentric | ext | external | exo | exterior | first | third | person
    | main | primary | secondary | global | scene | static | wide | table | workspace | robot | wrist | in | (?:in)?hand
    | eye | gripper | head | chest | shoulder | base
    """,
    re.VERBOSE,
)
_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+")


def is_named_like_a_camera(name: str) -> bool:
    """Returns whether a name has a word for a camera, or only words for where one is.

    `wrist_1` and `left-turn-cam` do, `left-turn-1` and `take-1` do not.
    """
    words = [word.lower() for word in _WORD.findall(name)]
    return any(map(_DEVICE.fullmatch, words)) or (bool(words) and all(map(_PLACE.fullmatch, words)))
