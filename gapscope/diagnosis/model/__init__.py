"""The model that is fitted: terms, their linearisation, and the normal equations."""
