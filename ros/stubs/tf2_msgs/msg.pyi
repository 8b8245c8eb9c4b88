from geometry_msgs.msg import TransformStamped

class TFMessage:
    transforms: list[TransformStamped]
