"""Which Kinects are plugged in, from the USB devices that the kernel lists, and what they need.

Product numbers: libfreenect, src/usb_libusb10.h. The first model (1414) has a separate device for
its motor; model 1473 and the Kinect for Windows drive it through their audio device, which works
only with a firmware that libfreenect uploads.
"""

from pathlib import Path

_SYSFS = Path('/sys/bus/usb/devices')
_MICROSOFT = '045e'
_CAMERA, _MOTOR, _AUDIO = '02ae', '02b0', '02ad'
_WINDOWS_CAMERA = '02bf'
_SECOND_GENERATION = ('02c4', '02d8')
_FIRMWARE = (
    'its audio device, through which libfreenect drives the motor, needs the firmware audios.bin: '
    'run fwfetcher.py of libfreenect (/usr/share/libfreenect), which saves it in ~/.libfreenect'
)


def _products(root: Path) -> list[str]:
    """Return the product numbers of Microsoft's devices, one for each device."""
    found = []
    for vendor in sorted(root.glob('*/idVendor')):
        try:
            if vendor.read_text(encoding='ascii').strip().lower() == _MICROSOFT:
                product = vendor.with_name('idProduct').read_text(encoding='ascii')
                found.append(product.strip().lower())
        except (OSError, UnicodeDecodeError):
            continue
    return found


def kinect_model(root: Path = _SYSFS) -> str:
    """Return the model of the Kinects that are plugged in, '' if none or several kinds are."""
    products = _products(root)
    models = []
    if _CAMERA in products:
        models.append('model 1414' if _MOTOR in products else 'model 1473')
    if _WINDOWS_CAMERA in products:
        models.append('for Windows, model 1517')
    return models[0] if len(models) == 1 else ''


def advice(root: Path = _SYSFS) -> str:
    """Return what keeps a Kinect from working as far as its USB devices show it, or ''."""
    products = _products(root)
    if _WINDOWS_CAMERA in products or (_CAMERA in products and _MOTOR not in products):
        return f'a Kinect ({kinect_model(root) or "several models"}) is plugged in: {_FIRMWARE}'
    if any(product in products for product in _SECOND_GENERATION):
        return 'a Kinect of the second generation is plugged in, which libfreenect cannot read'
    if _CAMERA not in products and (_MOTOR in products or _AUDIO in products):
        return (
            'the motor of a Kinect is on the USB, but not its camera: is its power supply (12 V) '
            'plugged in?'
        )
    return ''
