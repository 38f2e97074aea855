"""How well a team does: play whole episodes, summarise and film them."""

from assistax.evaluation.playing import EVALUATION_SEED, evaluate, play, summarize

__all__ = ["EVALUATION_SEED", "evaluate", "play", "summarize"]
