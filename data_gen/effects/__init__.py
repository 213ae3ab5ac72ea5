"""Effects beyond diffuse reflection, one file each: what only scenes pay for that call for them."""
