"""Native files of each dataset, written from synthetic readings; one layout a file."""
