"""How a blind check is shown: tables in Markdown and on the terminal, pictures in HTML."""
