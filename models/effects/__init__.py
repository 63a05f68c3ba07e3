"""What a sensor models only if it is asked to; of what is not asked for, nothing runs here."""
