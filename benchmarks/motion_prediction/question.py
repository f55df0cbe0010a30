"""The observed frames of one batch of windows, and the futures that a predictor answers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.engine import is_out_of_memory
from prbench.errors import AdapterError, PrbenchError
from prbench.harness.benchmark import Answer
from prbench.harness.methods.loading import LoadedMethod
from prbench.harness.methods.motions import release_memory, told
from prbench.harness.run_folder.predictions import PredictionRows
from prbench_benchmarks.motion_prediction.batch import ObservedBatch, ask


@dataclass(frozen=True)
class FutureQuestion:
    """See :class:`prbench.harness.benchmark.Question`; the predictor sees nothing but ``batch``."""

    batch: ObservedBatch
    n_samples: int

    def ask(
        self, method: LoadedMethod | None, *, seed: int, sequence_ids: tuple[str, ...], measure: Callable[[], None]
    ) -> Answer:
        """See :class:`prbench.harness.benchmark.Question`."""
        assert method is not None, "no control of this benchmark"
        joints, halvings = self._futures(self.batch, method, seed, sequence_ids)
        measure()
        n_frames = np.full(len(joints), self.batch.n_future)
        samples = [PredictionRows.from_padded(joints[:, sample], n_frames) for sample in range(self.n_samples)]
        return Answer(samples, [self.batch.key] * self.n_samples, halvings)

    def _futures(
        self, batch: ObservedBatch, method: LoadedMethod, seed: int, ids: tuple[str, ...]
    ) -> tuple[Float[np.ndarray, "batch samples future joints 3"], int]:
        """The answer, and how often a batch that did not fit in memory was cut in two."""
        try:
            futures = ask(method.adapter, batch, n_samples=self.n_samples, seed=seed)
        except PrbenchError:
            raise
        except (Exception, SystemExit) as error:
            if not is_out_of_memory(error):
                where = f"among windows {ids[0]} to {ids[-1]}"
                raise AdapterError(f"method '{method.name}' failed: {told(error)}, {where}.") from error
            if len(batch) == 1:
                raise AdapterError(
                    f"method '{method.name}' ran out of memory on the single window {ids[0]}"
                    f" ({self.n_samples} samples). Use a device with more memory, or fewer --samples."
                ) from error
        else:
            return np.asarray(futures.joints, dtype=np.float32), 0
        # Outside of the handler: its traceback would hold the tensors of the failed batch.
        release_memory()
        middle = len(batch) // 2
        first, halved_first = self._futures(batch.rows(0, middle), method, seed, ids[:middle])
        second, halved_second = self._futures(batch.rows(middle, len(batch)), method, seed, ids[middle:])
        return np.concatenate((first, second)), 1 + halved_first + halved_second
