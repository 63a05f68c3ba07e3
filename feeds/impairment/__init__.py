"""What a link does to messages: delays, losses, copies, flipped bits, a rate, their order.

Pure functions of messages and of chance. What becomes of copies is delivery's.
"""
