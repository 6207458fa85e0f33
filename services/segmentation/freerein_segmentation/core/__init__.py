"""Core of the segmentation service: whole trajectories and streams, and the decoding of probabilities into segments."""

from freerein_segmentation.core.inference import SkillModel as SkillModel
from freerein_segmentation.core.inference import run_batch as run_batch
from freerein_segmentation.core.segment_stream import SegmentStreamService as SegmentStreamService
from freerein_segmentation.core.segmenter import Segmenter as Segmenter
from freerein_segmentation.core.video_decoding import VideoDecoding as VideoDecoding
