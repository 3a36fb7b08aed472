"""Thinning (Xiong 2018): a uniform sample of the echoes is classified, the others follow the nearest of it."""
