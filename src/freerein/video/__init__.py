"""Decoding of mp4 and mov video, frame by frame in bounded memory (extra `video`).

    open_video --spawns--> child process (PyAV) --pipe--> VideoFrame, VideoFrame, ...

A damaged or hostile file can crash a decoder or make it take any time and memory. It runs in a child process of one
thread, with limits of the kernel, and whatever happens to the child is an error of the file.
"""

from freerein.video.reader import Video as Video
from freerein.video.reader import VideoBounds as VideoBounds
from freerein.video.reader import VideoFrame as VideoFrame
from freerein.video.reader import VideoInfo as VideoInfo
from freerein.video.reader import open_video as open_video
from freerein.video.sampling import frames_at_rate as frames_at_rate
