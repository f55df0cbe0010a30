"""Text encoders: captions to frozen token vectors (torch and transformers are imported when a text is encoded)."""

from prbench.text.encoder import EncodedText, TextEncoder
from prbench.text.registry import NAMES, text_encoder

__all__ = ["NAMES", "EncodedText", "TextEncoder", "text_encoder"]
