"""Verification of a dataset on disk, and a filter of outliers.

What is verified: the files are the ones that were made (`files`), verdicts follow from the columns
(`verdicts`), and, on request, episodes follow from their seeds (`replay`).
"""
