# The robot: lerobot-record of the expert's demonstrations, without waiting for the clock.
lerobot-record --robot.type=dynahoi --robot.realtime=false --robot.task=constant --robot.image_size=32 \
    --teleop.type=dynahoi_expert --dataset.repo_id=local/demonstrations --dataset.root=demonstrations \
    --dataset.fps=20 --dataset.single_task=catch --dataset.num_episodes=2 --dataset.episode_time_s=3 \
    --dataset.reset_time_s=1 --dataset.push_to_hub=false --play_sounds=false
python -c "
from lerobot.datasets.lerobot_dataset import LeRobotDataset
dataset = LeRobotDataset('local/demonstrations', root='demonstrations')
assert dataset.num_episodes == 2, dataset.num_episodes
"
