# Action tokens: it trains a tiny vision-language model of random weights on a dataset of a stranger and acts.
(cd "$REPOSITORY" && uv run --no-sync python - "$OLDPWD/smolvlm") <<'PYTHON'
import sys
from pathlib import Path

from tests.zoo.stand_ins import save_smolvlm

save_smolvlm(Path(sys.argv[1]))
PYTHON
python "$REPOSITORY/.ci/alone/train_and_act.py" actiontokens --policy.vlm_name="$PWD/smolvlm"
