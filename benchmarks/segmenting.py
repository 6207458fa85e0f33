"""How long labelling a trajectory takes through each door of the segmentation service, beside the model called in process.

The model is untrained, which changes no time. A REST call is timed from a body that is ready to be sent, as frames lie
on disk or come from a camera, to the parsed reply; a gRPC call from arrays to arrays. JSON comes in two forms: PNG
images, as multipart carries them, and one tensor of raw frames.
"""

import base64
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack, closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import httpx
import numpy as np
import numpy.typing as npt
import orjson
import torch

from benchmarks.report import Findings, Ratio
from benchmarks.rounds import Contestant, Effort, Times, race
from benchmarks.services import running
from freerein import images, tensors
from freerein.clients import Channel, SegmentationClient
from freerein.learning import weights
from freerein.serving.models import ModelStore
from freerein.types.common import ModelRef, Trajectory
from freerein.types.segmentation import SegmentRequest
from freerein_segmentation import model
from freerein_sim.worlds.tasks import tasks
from freerein_sim.worlds.wander import Wander
from freerein_sim.worlds.world import Task
