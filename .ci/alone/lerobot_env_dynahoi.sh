# The core with the environment: lerobot-eval plays an untrained policy of LeRobot's.
python - <<'PYTHON'
from lerobot.configs import FeatureType
from lerobot.envs.utils import env_to_policy_features
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors
from lerobot_env_dynahoi import DynahoiEnvConfig

features = env_to_policy_features(DynahoiEnvConfig(image_size=32))
outputs = {name: feature for name, feature in features.items() if feature.type is FeatureType.ACTION}
config = ACTConfig(
    input_features={name: feature for name, feature in features.items() if name not in outputs},
    output_features=outputs, device="cpu", push_to_hub=False, pretrained_backbone_weights=None, chunk_size=8,
    n_action_steps=8, dim_model=32, n_heads=2, dim_feedforward=32, n_encoder_layers=1, n_vae_encoder_layers=1,
)  # fmt: skip
ACTPolicy(config).save_pretrained("policy")
for processor in make_pre_post_processors(config):
    processor.save_pretrained("policy")
PYTHON
lerobot-eval --policy.path=policy --policy.device=cpu --env.type=dynahoi --env.task=constant --env.image_size=32 \
    --env.split=test_small --eval.n_episodes=1 --eval.batch_size=1 --output_dir=evaluation
test -s evaluation/eval_info.json
