"""Make the moving pictures of README and docs, docs/pictures/*.gif: ``python scripts/pictures/make_animations.py``.

Each is an episode of an environment. In those whose agent is an estimator, the estimate is CAST's or the train
filter's; in the others the scripted driver drives. The floor of the square has cables and a slippery patch.
"""

from pathlib import Path

import gymnasium as gym
import numpy as np
from PIL import Image

import castor_envs  # noqa: F401 - registers the environments
from castor_envs.floor import Cable, Floor, Patch
from estimators.plugins.registry import load_estimator

FOLDER = Path(__file__).parents[2] / "docs" / "pictures"
FLOOR = Floor(
    patches=(Patch(center=(1.5, 0.3), size=(0.6, 0.6), friction=0.025),),
    cables=tuple(
        Cable(center=(0.5 + 0.12 * i, 0.266), direction=np.pi / 2, length=0.08, diameter=0.01) for i in range(4)
    ),
)
PICTURES = {
    "umbmark": ("castor/UMBmark-v0", {"floor": FLOOR}, "cast-0"),
    "configuration": ("castor/Configuration-v0", {"train": "cfmmr-3", "path": "s-bend"}, "train-filter"),
    "asoc": ("castor/ASOC-v1", {"floor": "slippery", "control": "residual"}, None),
    "cfmmr": ("castor/CFMMR-v1", {"train": "cfmmr-2", "control": "residual"}, None),
}
"""Name of the file: the environment, its arguments, and the estimator where the agent is one."""
FRAMES, WIDTH, COLORS = 60, 400, 128


def frames(identity, arguments, estimator):
    """Return the pictures of an episode, one a step."""
    env = gym.make(identity, render_mode="rgb_array", **arguments)
    observation, info = env.reset(seed=0)
    vehicle = getattr(env.unwrapped, "robot", None) or getattr(env.unwrapped, "train")  # noqa: B009
    judged = load_estimator(estimator).factory() if estimator else None
    if judged is not None:
        judged.reset(vehicle, info["pose"])
    found, done = [env.render()], False
    while not done:
        action = np.zeros(env.action_space.shape) if judged is None else np.ravel(judged.update(observation))
        observation, _, terminated, truncated, _ = env.step(action)
        done = terminated or truncated
        if len(found) % 10 == 0 or done or judged is None:
            found.append(env.render())
        else:
            found.append(found[-1])
    env.close()
    return found


def save(name, pictures):
    """Write at most FRAMES of the pictures as a GIF."""
    chosen = [pictures[k] for k in np.linspace(0, len(pictures) - 1, min(FRAMES, len(pictures))).astype(int)]
    size = (WIDTH, WIDTH * chosen[0].shape[0] // chosen[0].shape[1])
    resized = [Image.fromarray(picture).resize(size) for picture in chosen]
    sheet = Image.new("RGB", (3 * size[0], size[1]))  # the colours of all pictures together, so that none flickers
    for k, of in enumerate((0, len(resized) // 2, -1)):
        sheet.paste(resized[of], (k * size[0], 0))
    palette = sheet.quantize(COLORS, Image.Quantize.MEDIANCUT)
    small = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in resized]
    small[0].save(FOLDER / f"{name}.gif", save_all=True, append_images=small[1:], duration=100, loop=0, optimize=True)


def main():
    """Draw and save all."""
    FOLDER.mkdir(exist_ok=True)
    for name, episode in PICTURES.items():
        save(name, frames(*episode))


if __name__ == "__main__":
    main()
