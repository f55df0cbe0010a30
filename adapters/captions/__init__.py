"""TM2T's captioner: motion tokens in, a sentence out (docs/specification/captions.md#captioner)."""
