"""Generation of datasets: plan, shards, worker processes, cluster executors, and policies that act
in them.
"""
