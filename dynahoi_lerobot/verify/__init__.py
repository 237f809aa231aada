"""Verification of a dataset on disk, and a filter of outliers.

Verified are the files, which must be the signed ones (`files`); that LeRobot reads them (`format`);
that verdicts follow from the columns (`verdicts`); and that episodes follow from their seeds
(`replay`).
"""
