"""Commands that train agents and judge how well an arm is tracked with them."""
