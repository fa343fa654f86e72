"""Why a simulation and the real thing disagree: where the gap lies, which effect causes it, how far it shrinks."""
