"""Files are damaged at random, and what prbench makes of them is judged (``docs/reliability.md``)."""
