"""Where shards are made when one pool of processes is not enough: one file per kind of cluster.

The work of scheduling is datatrove's; the extra ``scale`` brings it.
"""
