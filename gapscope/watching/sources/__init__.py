"""Where samples come from while they are being recorded: a growing text file, a folder of recordings or of bags."""
