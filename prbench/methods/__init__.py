"""How a method is reached: installed under an entry point, in this process, as a program over Arrow, or isolated."""
