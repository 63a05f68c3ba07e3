"""Packet captures: pcap and pcapng, and the link layers that hold UDP datagrams."""
