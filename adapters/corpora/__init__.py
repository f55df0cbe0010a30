"""Text-motion corpora for pre-training: Nymeria, HumanML3D and synthetic people, in one table."""

from prbench_adapters.corpora.build import CorpusPlan, CorpusReport, build_corpus, plan_corpus
from prbench_adapters.corpora.sources import CorpusOptions

__all__ = ["CorpusOptions", "CorpusPlan", "CorpusReport", "build_corpus", "plan_corpus"]
