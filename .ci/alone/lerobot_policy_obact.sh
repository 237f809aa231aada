# ObAct without the simulator: it trains on a dataset of a stranger and acts.
python "$REPOSITORY/.ci/alone/train_and_act.py" obact --policy.encoder=conv --policy.freeze_encoder=false \
    --policy.relative_dims=0 --policy.dim=16 --policy.n_heads=2 --policy.width=32 --policy.horizon=4 \
    --policy.n_action_steps=2 --policy.n_obs_steps=3 --policy.head_options='{"width": 16}' \
    --policy.encoder_options='{"channels": 8}'
