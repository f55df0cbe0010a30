"""Text-motion corpora for pre-training: Nymeria, HumanML3D and invented people, in one table."""

from prbench.corpora.build import CorpusReport, build_corpus
from prbench.corpora.options import CorpusOptions
from prbench.corpora.plan import CorpusPlan, plan_corpus

__all__ = ["CorpusOptions", "CorpusPlan", "CorpusReport", "build_corpus", "plan_corpus"]
