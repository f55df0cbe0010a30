"""Turns a sequence table and a method into scores: conditions, generation, controls, scoring, summaries.

Start at :func:`prbench.evaluation.run.run_method`. Nothing is imported here, so that listing the installed methods
stays quick.
"""
