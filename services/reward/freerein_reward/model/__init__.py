"""The dual encoder: image encoder, text encoder, tokenizer, inference, loading."""

from freerein_reward.model.dual_encoder import DualEncoder as DualEncoder
from freerein_reward.model.dual_encoder import Temperature as Temperature
from freerein_reward.model.dual_encoder import channels_last as channels_last
from freerein_reward.model.dual_encoder_model import DualEncoderModel as DualEncoderModel
from freerein_reward.model.dual_encoder_model import ImageEmbeddings as ImageEmbeddings
from freerein_reward.model.dual_encoder_model import preprocess as preprocess
from freerein_reward.model.grounding import GradCamModel as GradCamModel
from freerein_reward.model.grounding import PhraseLocations as PhraseLocations
from freerein_reward.model.grounding import PhraseLocator as PhraseLocator
from freerein_reward.model.grounding import contrast_texts as contrast_texts
from freerein_reward.model.grounding import heat_of_presence as heat_of_presence
from freerein_reward.model.imported_grounding import LAYOUTS as LAYOUTS
from freerein_reward.model.imported_grounding import Calibration as Calibration
from freerein_reward.model.imported_grounding import ImportedGrounding as ImportedGrounding
from freerein_reward.model.known_phrases import KNOWN as KNOWN
from freerein_reward.model.known_phrases import NULL_TEXTS as NULL_TEXTS
from freerein_reward.model.known_phrases import REFERENCES as REFERENCES
from freerein_reward.model.known_phrases import KnownPhrases as KnownPhrases
from freerein_reward.model.loading import GROUNDING as GROUNDING
from freerein_reward.model.loading import is_grounding as is_grounding
from freerein_reward.model.loading import load_built_in as load_built_in
from freerein_reward.model.loading import load_grounding as load_grounding
from freerein_reward.model.loading import load_reward_model as load_reward_model
from freerein_reward.model.spec import DualEncoderSpec as DualEncoderSpec
from freerein_reward.model.text_encoder import ClipTextEncoder as ClipTextEncoder
from freerein_reward.model.tokenizer import Tokenizer as Tokenizer
