"""Generation of datasets: plan, shards, worker processes and cluster executors."""
