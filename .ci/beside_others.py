"""Use the installed package from a folder that holds packages called envs, agents, arm and utils.

Run by the Python of an environment with the wheel; makes the folder, and starts a script in it as a user would.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

OTHERS = ("envs", "agents", "arm", "effects", "ident", "utils")
SCRIPT = """
import envs, agents, arm, effects, ident, utils
import gapscope
import gymnasium as gym

assert envs.MINE and agents.MINE and arm.MINE and utils.MINE
env = gym.make("gapscope/ArmTracking-v0", episode_length=0.2)
env.reset(seed=0)
env.step(env.action_space.sample())
print("gapscope", gapscope.__version__, "beside", envs.__file__)
"""
WITHOUT_IMPORT = """
import gymnasium as gym

gym.make("gapscope:gapscope/ArmTracking-v0", episode_length=0.2).reset(seed=0)
gym.make_vec("gapscope:gapscope/ArmTracking-v0", num_envs=2, episode_length=0.2).reset(seed=0)
print("gym.make and gym.make_vec without an import")
"""


def main() -> None:
    """Make the folder and run both scripts in it; an error there is an error here."""
    with tempfile.TemporaryDirectory() as folder:
        for name in OTHERS:
            package = Path(folder) / name
            package.mkdir()
            (package / "__init__.py").write_text("MINE = True\n", encoding="utf-8")
        for number, text in enumerate((SCRIPT, WITHOUT_IMPORT)):
            script = Path(folder) / f"train_{number}.py"
            script.write_text(text, encoding="utf-8")
            subprocess.run([sys.executable, str(script)], cwd=folder, check=True)


if __name__ == "__main__":
    main()
