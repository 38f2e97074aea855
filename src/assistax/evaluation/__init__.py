"""How well a team does: play whole episodes, say what they came to, film them."""

from assistax.evaluation.playing import EVALUATION_SEED, evaluate, play, summarize

__all__ = ["EVALUATION_SEED", "evaluate", "play", "summarize"]
