"""An arm plus effects: what it predicts, how that changes with parameters, and what data say about them."""
