"""Names and constants of native formats, shared by readers and synthetic layouts."""
