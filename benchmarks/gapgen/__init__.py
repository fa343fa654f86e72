"""Generator, sealer and scorer of recordings whose unmodelled effect is withheld from the diagnosis."""
