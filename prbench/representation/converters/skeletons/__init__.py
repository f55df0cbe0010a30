"""Joints of other skeletons to the 22: named maps, maps of the user's own, and proportions for what is missing."""
