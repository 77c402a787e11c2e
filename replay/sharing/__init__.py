"""What may be given to strangers: text and recordings without secrets and names."""
