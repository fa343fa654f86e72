"""How the matter of a film moves with the state: bodies, found from the film, and the motion of each."""
