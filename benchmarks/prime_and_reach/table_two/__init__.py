"""Table 2 of *Prime and Reach* in one command: its rows planned, run unattended, and printed in its layout."""
