"""The loop of observing, acting and recording that generation, evaluation and the environments
share.
"""
