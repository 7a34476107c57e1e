"""A cable of two tap devices whose frames can be delayed and lost, for kernels without netem.

    python3 slow_link.py NEAR FAR

Both devices are made in the network namespace where this runs. Frames pass at once until the signal
USR1 comes; from then on each is delayed by 200 ms with 50 ms of jitter, in order as on a real link,
and one of twenty is lost. USR2 ends that.
"""

import fcntl
import heapq
import os
import random
import select
import signal
import struct
import sys
import time

TUNSETIFF = 0x400454CA
IFF_TAP = 0x0002
IFF_NO_PI = 0x1000
DELAY_S = 0.200
JITTER_S = 0.050
LOSS = 0.05
# Frames that may be on the way: a second of a link that is far faster than any robot's.
MOST_ON_THE_WAY = 10_000
LONGEST_FRAME = 65_536


def tap(name):
    device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(device, TUNSETIFF, struct.pack("16sH22x", name.encode(), IFF_TAP | IFF_NO_PI))
    return device


def main():
    near, far = tap(sys.argv[1]), tap(sys.argv[2])
    other = {near: far, far: near}
    slow = False
    chance = random.Random(1)
    on_the_way = []
    last = {near: 0.0, far: 0.0}
    number = 0

    def switch(signal_number, _):
        nonlocal slow
        slow = signal_number == signal.SIGUSR1

    signal.signal(signal.SIGUSR1, switch)
    signal.signal(signal.SIGUSR2, switch)
    print("ready")
    while True:
        wait = max(0.0, on_the_way[0][0] - time.monotonic()) if on_the_way else None
        readable, _, _ = select.select([near, far], [], [], wait)
        now = time.monotonic()
        for device in readable:
            try:
                frame = os.read(device, LONGEST_FRAME)
            except (BlockingIOError, OSError):
                continue
            if slow and (chance.random() < LOSS or len(on_the_way) >= MOST_ON_THE_WAY):
                continue
            delay = chance.uniform(DELAY_S - JITTER_S, DELAY_S + JITTER_S) if slow else 0.0
            # A link does not reorder: no frame arrives before the one that was sent before it.
            last[device] = max(last[device], now + delay)
            number += 1
            heapq.heappush(on_the_way, (last[device], number, other[device], frame))
        now = time.monotonic()
        while on_the_way and on_the_way[0][0] <= now:
            _, _, device, frame = heapq.heappop(on_the_way)
            try:
                os.write(device, frame)
            except OSError:
                pass  # The far end is down: the frame is lost, as on a real cable.


main()
