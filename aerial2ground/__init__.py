"""Learning to drive and to localise on the ground from pictures taken in the air."""
