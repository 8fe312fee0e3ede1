"""Episodes as files for other programs: logs, poses as TUM or KITTI text, maps of floors."""
