"""What a link does to messages: delays, losses, copies, flipped bits, a rate, their order."""
