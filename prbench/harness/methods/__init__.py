"""Ways to a method: installed under an entry point, in this process, as a program over Arrow, or isolated."""
