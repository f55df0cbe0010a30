"""Runs of methods over tables: planning, asking, answers, scores, intervals, run folders.

Start at :func:`prbench.harness.run.run_method`. Nothing is imported here, so that listing the installed methods
stays quick.
"""
