"""The eye outside the policy: a sensor for datasets and environments, and its pretraining."""
