"""A recorded ledger as a table, a chart and JSON: what was asked beside what was delivered.

It reads recordings alone. What is counted for the live page too stands in `recording`.
"""
