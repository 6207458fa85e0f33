"""Core of the segmentation service: `Segmenter`, and the decoding of probabilities into segments."""

from freerein_segmentation.core.segmenter import Segmenter as Segmenter
from freerein_segmentation.core.segmenter import SkillModel as SkillModel
from freerein_segmentation.core.segmenter import segment_batch as segment_batch
