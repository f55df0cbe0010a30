"""The layout of the authors' release: import it with what it leaves open written down, and export any table to it."""
