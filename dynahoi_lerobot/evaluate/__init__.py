"""Closed-loop evaluation: result folders, intervals, strata, paired comparisons, tables and
clips.
"""
