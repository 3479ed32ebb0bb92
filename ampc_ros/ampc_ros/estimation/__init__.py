"""What a controller knows about its car: predicted state, adapted model, stored estimates."""
