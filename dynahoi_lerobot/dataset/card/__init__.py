"""The dataset card: ``README.md`` and its pictures, as LeRobot's ``push_to_hub`` writes it, with all fields filled."""
