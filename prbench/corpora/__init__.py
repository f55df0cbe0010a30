"""Text-motion corpora for pre-training: Nymeria, HumanML3D and synthetic people, in one table."""

from prbench.corpora.build import CorpusPlan, CorpusReport, build_corpus, plan_corpus
from prbench.corpora.sources import CorpusOptions

__all__ = ["CorpusOptions", "CorpusPlan", "CorpusReport", "build_corpus", "plan_corpus"]
