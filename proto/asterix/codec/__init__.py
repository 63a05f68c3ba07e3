"""What all categories share: layouts as data, and what is made from them.

`layout` reads categories, `decode` their records by compiled readers. `encode` writes records
column by column, and data blocks of what is measured. `retime_asterix` moves times in what others
wrote.
"""
