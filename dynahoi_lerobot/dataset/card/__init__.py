"""The dataset card: ``README.md`` and its images, in the form that LeRobot's ``push_to_hub`` writes."""
