"""A method's motions for the texts of a corpus, as the evaluator takes them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.contract import Adapter, Condition, ConditionBatch, Trainable
from prbench.errors import UsageError
from prbench.files.storage import text_digest
from prbench.harness.methods.loading import chosen_condition, load_adapter, weights_digest
from prbench.harness.methods.motions import Declared, generate_checked, native_frames
from prbench.randomness import noise_seed
from prbench.representation import encode
from prbench_benchmarks.text_to_motion.clips import Clip, Draw, longest
from prbench_benchmarks.text_to_motion.networks import EvaluatorConfiguration


@dataclass(frozen=True, kw_only=True)
class MethodRequest:
    """The method whose motions are evaluated, and its settings."""

    name: str
    weights: Path | None = None
    """Weights; None for the method's default."""
    options: tuple[tuple[str, str], ...] = ()
    device: str = "cpu"
    batch_size: int = 64


@dataclass(frozen=True)
class Prompt:
    """One motion to generate."""

    sequence_id: str
    draw: Draw
    sample: int


@dataclass(frozen=True)
class Generator:
    """A loaded method that takes texts."""

    request: MethodRequest
    adapter: Adapter
    seed: int
    fps: float
    weights_sha256: str | None

    @classmethod
    def load(cls, request: MethodRequest, *, seed: int, fps: float) -> Generator:
        """Load a method.

        Raises:
            AdapterError: if it cannot be loaded or takes no text.
            UsageError: if it would have to learn first.
        """
        adapter = load_adapter(request.name, request.weights, dict(request.options), request.device)
        chosen_condition(request.name, adapter, Condition.TEXT)
        if isinstance(adapter, Trainable) and request.weights is None:
            raise UsageError(f"the method '{request.name}' learns from a table first; give it --weights.")
        return cls(request, adapter, seed, fps, weights_digest(request.weights))

    def supports(self, clip: Clip, configuration: EvaluatorConfiguration) -> bool:
        """Return True if the method can generate as many frames as a clip may ask for."""
        declared = Declared.by(self.adapter, origin=f"adapter '{self.request.name}'")
        if declared.max_frames is None:
            return True
        asked = np.array([longest(clip, configuration)])
        native = native_frames(asked, fps=self.fps, native_fps=declared.native_fps or self.fps)
        return int(native[0]) <= declared.max_frames

    def features(
        self, prompts: Sequence[Prompt], configuration: EvaluatorConfiguration
    ) -> Iterator[tuple[int, Float[np.ndarray, "n 263"]]]:
        """Generate and encode; motions of similar length together.

        Yields:
            The place of a prompt, and the features of its motion, one row a frame; every prompt once.
        """
        # By length, so that little is computed for padding; the place breaks ties, so that the order is fixed.
        order = sorted(range(len(prompts)), key=lambda place: (prompts[place].draw.n_frames, place))
        for start in range(0, len(order), self.request.batch_size):
            places = order[start : start + self.request.batch_size]
            chosen = [prompts[place] for place in places]
            motions, _ = generate_checked(
                self.adapter,
                self._batch(chosen),
                seed=self.seed,
                method=self.request.name,
                sequence_ids=[prompt.sequence_id for prompt in chosen],
            )
            for place, prompt, joints in zip(places, chosen, motions.joints):
                name = f"{self.request.name}'s motion for {prompt.sequence_id}"
                yield place, generated_features(joints[: prompt.draw.n_frames], configuration, name=name)

    def _batch(self, prompts: Sequence[Prompt]) -> ConditionBatch:
        return ConditionBatch(
            condition=Condition.TEXT,
            n_frames=np.array([prompt.draw.n_frames for prompt in prompts], dtype=np.int64),
            fps=self.fps,
            # Methods must not recognise sequences, so they see a digest in place of the id.
            opaque_id=tuple(text_digest("opaque", str(self.seed), prompt.sequence_id)[:16] for prompt in prompts),
            noise_seed=tuple(noise_seed(self.seed, prompt.sequence_id, prompt.sample) for prompt in prompts),
            text=tuple(prompt.draw.caption for prompt in prompts),
        )


def generated_features(
    joints: Float[np.ndarray, "n 22 3"], configuration: EvaluatorConfiguration, *, name: str
) -> Float[np.ndarray, "n 263"]:
    """Features of a generated motion, which is canonical as it is; its last step is taken once more for the last row.

    Raises:
        InputFileError: if a pose cannot be encoded; it begins with ``name``.
    """
    # A row of features describes the step to the next frame, and the last frame has none.
    beyond = 2 * joints[-1] - joints[-2]
    return encode(joints, next_joints=beyond, mode=configuration.representation, source=name, upright=False)
